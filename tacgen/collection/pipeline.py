"""One grasp from the plan to the sample that a shard holds: where the stages are joined."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.confidence import label_confidence
from tacgen.collection.gel import SETTLED_PRESS, contact_law, gel_patch, mounted_sensor
from tacgen.collection.grid import Grids, PlannedGrasp
from tacgen.collection.perturbed import (
    Variation,
    draw_variation,
    perturbed_object,
    recipe_object,
    vary_config,
)
from tacgen.collection.recipe import Recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.collection.scene import PICTURE_PX, camera_samples, cameras_of, grasp_picture
from tacgen.contact.gel_response import GelLoad, gel_loads, is_near, rounded_pose_and_load
from tacgen.contact.indenter import Imprint
from tacgen.contact.law import ContactLaw
from tacgen.core.errors import SensorError, require_extra
from tacgen.core.records import ContactFrame, GraspConfig, GraspObject, GraspTrace, rng_of
from tacgen.core.sensors import load_sensor
from tacgen.core.types import FloatArray
from tacgen.dataset import CameraSample, DatasetSpec, GraspSample, PadSample
from tacgen.physics import FrameRequest, GelModel, GraspSimulator
from tacgen.physics.grasp import StartedGrasp, not_executed
from tacgen.physics.rest import topples_deg
from tacgen.sensor.tactile_pad import TactilePad

CALIBRATION = ("table", "contact_law")
# Streams of one grasp's random numbers.
_STREAM_VARIATION, _STREAM_NOISE, _STREAM_NOISE_AT_REST = range(3)
NOTHING = "nothing has been grasped yet"
_UNLOADED = ContactFrame(0.0, 0.0, np.zeros(2), 0.0, np.eye(4))


@dataclass(frozen=True, slots=True)
class SimulatedGrasp:
    """The physics of one planned grasp, with what was drawn for it where the recipe varies."""

    planned: PlannedGrasp
    grasped: GraspObject
    config: GraspConfig
    variation: Variation
    trace: GraspTrace


@dataclass(frozen=True, slots=True)
class HeldGrasp:
    """A grasp that is held and not yet lifted, until the pipeline starts the next one."""

    _started: StartedGrasp
    _simulated: Callable[[GraspTrace], SimulatedGrasp]

    def look(self) -> SimulatedGrasp:
        """The grasp up to its lift; ``StartedGrasp.held`` says what is known of it."""
        return self._simulated(self._started.held())

    def lift(self) -> SimulatedGrasp:
        """The whole grasp."""
        return self._simulated(self._started.lift())


class GraspPipeline:
    """A simulator and a sensor, kept open for many grasps of one recipe; a context manager.

    A sample depends on the recipe and its place in the plan alone, not on the grasps before it.
    ``objects_kept`` is how many objects stay loaded; ``device`` draws all images of a pad at once,
    as ``optics.device`` of the recipe says.

    Raises ``SensorError`` if the device is not here, or cannot draw the sensor's images.
    """

    def __init__(self, recipe: Recipe, device: str = "none", *, objects_kept: int = 4) -> None:
        self.recipe, self._settings = recipe, recipe.physics_settings
        self._law = contact_law(recipe.contact)
        self._pad = tactile_pad(recipe)
        self._on_device = None
        if device != "none":
            require_extra("batch", f"optics.device = {device!r} needs", SensorError)
            from tacgen.batch.pad_images import PadImages

            self._on_device = PadImages(self._pad, len(planned_times_s(recipe)), device)
        self.simulator = GraspSimulator(recipe.robot.spec(), recipe.physics.engine)
        self._object = lru_cache(maxsize=objects_kept)(recipe_object)

    def __enter__(self) -> "GraspPipeline":
        self.simulator.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self.simulator.__exit__(*raised)

    def simulate(self, planned: PlannedGrasp) -> SimulatedGrasp:
        """The physics of one grasp."""
        return self.start(planned).lift()

    def start(
        self, planned: PlannedGrasp, attempt: int = 0, *, frames: FrameRequest | None = None
    ) -> HeldGrasp:
        """The physics of one grasp up to the lift.

        ``attempt`` counts how often this object, with what was drawn of it and of the sensor, has
        been grasped before: where the gripper comes to is drawn anew, and so is the camera's noise.
        ``frames`` are taken instead of the recipe's.
        """
        grasped, config, variation = self._drawn(planned, attempt)
        patch_of = partial(
            gel_patch,
            self._pad.indenter,
            self._law,
            grasped.surface,
            k_n_factor=variation.k_n_factor,
        )
        started = StartedGrasp(
            self.simulator,
            grasped,
            config,
            self._settings,
            frames=frames or self.recipe.frames,
            gel=GelModel(patch_of, bool(self._law.effects)),
        )
        return HeldGrasp(started, partial(SimulatedGrasp, planned, grasped, config, variation))

    def at_rest(self, planned: PlannedGrasp) -> SimulatedGrasp:
        """What a planned grasp draws, before anything is grasped."""
        drawn = self._drawn(planned, 0)
        pads = self._settings.sensing_pads
        return SimulatedGrasp(planned, *drawn, not_executed(drawn[1], "no_contact", NOTHING, pads))

    def stands(self, planned: PlannedGrasp) -> bool:
        """Whether the object of a planned grasp stands, with what is drawn of it."""
        return not topples_deg(self.at_rest(planned).grasped)

    def _drawn(
        self, planned: PlannedGrasp, attempt: int
    ) -> tuple[GraspObject, GraspConfig, Variation]:
        """The object, the configuration as it is carried out, and what was drawn for them."""
        spread = self.recipe.randomize
        variation = draw_variation(spread, rng_of(planned.seed, _STREAM_VARIATION))
        if attempt:
            anew = draw_variation(spread, rng_of(planned.seed, _STREAM_VARIATION, attempt))
            variation = replace(variation, position_mm=anew.position_mm, yaw_rad=anew.yaw_rad)
        base = self._object(self.recipe.objects[planned.entry])
        grasped = perturbed_object(base, variation.perturbation)
        return grasped, vary_config(planned.config, variation), variation

    def render(
        self,
        grasp: SimulatedGrasp,
        pad: str,
        *,
        rng: np.random.Generator | None = None,
        law: ContactLaw | None = None,
    ) -> tuple[NDArray[np.uint8], list[Imprint]]:
        """The images (T, H, W, 3) and imprints of a pad by ``law``, else the recipe's, before gain.

        ``rng`` draws the camera's noise.
        """
        imprints = self._imprints(grasp, pad, law or self._law)
        if self._on_device is not None:
            images = self._on_device.images(imprints, rng)
        else:
            images = np.empty((len(imprints), *self._pad.sensor.shape_px, 3), dtype=np.uint8)
            for imprint, rgb in zip(imprints, images, strict=True):
                self._pad.image(imprint, rng=rng, rgb=rgb)
        return images, imprints

    def _imprints(self, grasp: SimulatedGrasp, pad: str, law: ContactLaw) -> list[Imprint]:
        """What a pad's gel shows in each frame.

        Its shear goes on from the trace's ``gel_steps`` alone, so that a frame does not depend on
        which others are kept; up to the first of these the gel comes to its load from rest.
        """
        trace, surface = grasp.trace, grasp.grasped.surface

        def loaded(frames: Sequence[ContactFrame]) -> Iterator[tuple[float, FloatArray, GelLoad]]:
            loads = gel_loads(
                law,
                frames,
                grasp_index=SETTLED_PRESS,
                k_n_factor=grasp.variation.k_n_factor,
                friction=grasp.grasped.friction,
            )
            for frame, load in zip(frames, loads, strict=True):
                yield frame.time_s, *rounded_pose_and_load(frame.pose_gel_object, load)

        steps = deque(loaded(trace.gel_steps.get(pad, ())))
        imprints: list[Imprint] = []
        before: Imprint | None = None
        advanced: tuple[FloatArray, GelLoad] | None = None
        shown: tuple[FloatArray, GelLoad, Imprint | None] | None = None
        for time_s, pose, load in loaded(trace.frames[pad]):
            while steps and steps[0][0] < time_s:
                _, at, by = steps.popleft()
                if advanced is None or not is_near(at, by, *advanced):
                    before, advanced = self._pad.advance(surface, at, by, before), (at, by)
            if shown and shown[2] is before and load == shown[1] and (pose == shown[0]).all():
                imprints.append(imprints[-1])
            else:
                imprints.append(self._pad.press(surface, pose, load, before))
            shown = pose, load, before
        return imprints

    def picture(self, grasp: SimulatedGrasp) -> NDArray[np.uint8]:
        """The scene from outside at the moment of grasp, (h, w, 3)."""
        trace, gripper = grasp.trace, self.simulator.robot.gripper
        return grasp_picture(grasp.grasped, grasp.config, trace, trace.grasp_frame, gripper)

    def camera_samples(self, grasp: SimulatedGrasp) -> dict[str, CameraSample]:
        """What each camera of the recipe sees.

        That is the object alone, as it stood before, where the grasp was not executed.
        """
        trace, gripper = grasp.trace, self.simulator.robot.gripper
        if trace.status != "executed":
            stands = np.tile(
                (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (len(planned_times_s(self.recipe)), 1)
            )
            trace = replace(trace, object_pose=stands)
        return camera_samples(self.recipe, grasp.grasped, trace, gripper)

    def sample(self, planned: PlannedGrasp) -> GraspSample:
        """Simulate one grasp and render the images of its pads."""
        grasp = self.simulate(planned)
        trace, executed = grasp.trace, grasp.trace.status == "executed"
        return GraspSample(
            **trace.outcome(),
            config=planned.config,
            seed=planned.seed,
            split=planned.split,
            pads=self.pad_samples(grasp) if executed else {},
            object_pose=trace.object_pose if executed else None,
            label_confidence=label_confidence(trace, grasp.grasped, self.recipe),
            picture=self.picture(grasp) if self.recipe.dataset.scene_pictures else None,
            cameras=self.camera_samples(grasp) if executed else {},
        )

    def pad_samples(self, grasp: SimulatedGrasp, attempt: int = 0) -> dict[str, PadSample]:
        """What each sensing pad shows; gels at rest where the grasp was not executed.

        ``attempt`` is that of ``start``.
        """
        trace, executed = grasp.trace, grasp.trace.status == "executed"
        stream = _STREAM_NOISE if executed else _STREAM_NOISE_AT_REST
        noise = self._noise_of(grasp.planned, stream, attempt)
        count = len(planned_times_s(self.recipe))
        samples = {}
        for pad, frames in trace.frames.items():
            if executed:
                images, imprints = self.render(grasp, pad, rng=noise)
            else:
                frames, imprints = (_UNLOADED,) * count, [Imprint()] * count
                images = np.stack([self._pad.image(one, rng=noise) for one in imprints])
            rgb = with_gain(images, grasp.variation.gain_factor)
            shares = [self._pad.visible_share(one) for one in images]
            samples[pad] = self._pad_sample(rgb, frames, imprints, trace.grasp_frame, shares)
        return samples

    def _noise_of(
        self, planned: PlannedGrasp, stream: int, attempt: int
    ) -> np.random.Generator | None:
        if self.recipe.optics.noise is not True:
            return None
        return rng_of(planned.seed, stream, *([attempt] if attempt else []))

    def _pad_sample(
        self,
        rgb: NDArray[np.uint8],
        frames: Sequence[ContactFrame],
        imprints: Sequence[Imprint],
        moment: int,
        shares: Sequence[float],
    ) -> PadSample:
        statuses = np.array([imprint.status for imprint in imprints])
        no_contact = statuses == "no_contact"
        return PadSample(
            rgb=rgb,
            force_normal_n=np.array([frame.force_normal_n for frame in frames]),
            force_shear_n=np.array([frame.force_shear_n for frame in frames]),
            indentation_mm=np.array([imprint.indentation_mm for imprint in imprints]),
            saturated=np.array([imprint.saturated for imprint in imprints]),
            no_contact=no_contact,
            nothing_to_see=(np.array(shares) == 0) & ~no_contact,
            outside_window=statuses == "outside_window",
            outside_share=np.stack([self._pad.indenter.outside_share(one) for one in imprints]),
            visible_share=np.array(shares),
            **self._touch(frames, imprints, moment),
        )

    def _touch(
        self, frames: Sequence[ContactFrame], imprints: Sequence[Imprint], moment: int
    ) -> dict[str, NDArray[np.floating]]:
        """What the recipe keeps of the touch beside the images; see ``PadSample``."""
        asked, pad = self.recipe.dataset, self._pad
        found: dict[str, NDArray[np.floating]] = {}
        if asked.depth != "none":
            kept = imprints if asked.depth == "all" else [imprints[moment]]
            maps = np.stack([one.depth_map_mm(pad.sensor) for one in kept]).astype(np.float16)
            found["depth_mm"] = maps if asked.depth == "all" else maps[0]
        if asked.markers:
            moved_mm = [pad.marker_motion_mm(imprint) for imprint in imprints]
            found["markers_mm"] = np.stack(moved_mm).astype(np.float32)
        if asked.force_field is not None:
            fields_n = [
                pad.force_field_n(imprint, imprint.share * frame.force_n, asked.force_field)
                for frame, imprint in zip(frames, imprints, strict=True)
            ]
            found["force_field_n"] = np.stack(fields_n).astype(np.float32)
        return found


def tactile_pad(recipe: Recipe) -> TactilePad:
    """The tactile pad of a recipe with its table; raises as ``TactilePad``."""
    drawn = recipe.optics.model_dump(include={"shadows", "markers"})
    return TactilePad(mounted_sensor(recipe), camera=recipe.contact.camera, **drawn)


def planned_times_s(recipe: Recipe) -> tuple[float, ...]:
    """Times of a grasp's frames from the start of closing on; 0 for the single one.

    The frame of the moment of grasp is taken at that moment instead.
    """
    frames = recipe.frames
    if frames.mode == "single":
        return (0.0,)
    if frames.count == 1:
        return (frames.span_s,)
    return tuple(np.linspace(0.0, frames.span_s, frames.count).tolist())


def with_gain(rgb: NDArray[np.uint8], gain: float) -> NDArray[np.uint8]:
    """Images (..., 3) of a camera whose gain is off by that factor."""
    if gain == 1.0:
        return rgb
    return np.asarray(np.clip(np.rint(rgb * np.float32(gain)), 0, 255), np.uint8)


def dataset_spec(
    recipe: Recipe,
    n_grasps: int,
    *,
    grids: tuple[Grids, ...] = (),
    parts: tuple[int, ...] = (),
    folder: Path | None = None,
) -> DatasetSpec:
    """What all shards of a recipe's dataset in ``folder`` have in common; see ``GraspPlan``.

    Raises ``TacgenError`` if an object, the sensor, its table or the contact law cannot be used.
    """
    sensor = load_sensor(recipe.sensor)
    inputs = recipe_inputs(recipe)
    at_load = recipe.optics.noise == "at_load"
    pad, asked = tactile_pad(recipe), recipe.dataset
    return DatasetSpec(
        recipe=recipe.resolved(folder),
        recipe_sha256=inputs.sha256["recipe"],
        calibration={k: inputs.sha256[k] for k in CALIBRATION if k in inputs.sha256},
        inputs=inputs.with_grids(grids),
        grids=grids,
        parts=parts,
        sensor=sensor,
        pads=recipe.physics_settings.sensing_pads,
        time_s=planned_times_s(recipe),
        n_grasps=n_grasps,
        shard_size=recipe.dataset.shard_size,
        reference_rgb=pad.at_rest_rgb,
        noise_at_load_grey=pad.table.noise_grey if at_load else 0.0,
        colors_from=pad.table.origin,
        depth=asked.depth == "grasp",
        depth_of_frames=asked.depth == "all",
        marker_rest_mm=pad.marker_rest_mm if asked.markers else None,
        force_field=asked.force_field,
        picture_px=PICTURE_PX if recipe.dataset.scene_pictures else None,
        cameras=cameras_of(recipe),
        camera_frames=recipe.scene.frames == "all",
    )
