"""From tactile images to the network's input: choose, resize, subtract, normalise."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter1d
from sklearn.preprocessing import StandardScaler

from tacgen.core.errors import LearningError
from tacgen.core.records import Camera, Until
from tacgen.dataset.real_grasps import FRAME_UNKNOWN
from tacgen.learning.grasps import COMMANDED, GraspSource, frames_until
from tacgen.learning.training_recipe import Augmentation, BesideImage

MIN_STD = 1e-3  # grey levels; a channel that never changes is not amplified beyond this
PRESSED_FRACTION = 0.95
"""Share of the change soon after; the simulated moment of grasp is at this share of the force."""
MIN_RMS = 1e-9  # of a channel beside the image; a number that never changes is not amplified
MIN_GAIN = 0.1  # of an image against the gel at rest; a darker one shows nothing to amplify
FAINT_GREY = 1.0  # contrast of the camera's noise at the network's size, which is not amplified


WITHOUT_TOUCH = ("commanded", "object")
"""The channels beside the image that a robot knows without touching."""
ARRAYS = {
    "markers": "markers_mm",
    "force_field": "force_field_n",
    "commanded": COMMANDED,
    "object": "object",
}
"""The array of each channel beside the image."""
ACROSS = ("sensor", "table", "pad", "markers", "shadows", "time_s", "until")
"""In what images may differ from those of the training; see ``Dataset.taken_with``."""


@dataclass(frozen=True, slots=True)
class TouchInput:
    """A channel beside the image: its name in recipes, and the ``shape`` of one frame.

    ``scale`` is the root mean square in training of each entry of its last axis, by which it is
    divided: x and y of markers, shear x, shear y and normal of a force field. Of what was commanded
    the mean in training, ``offset``, is subtracted before. ``objects`` are those of the training,
    of which the channel ``object`` has a 1 for the grasped one, and zeros; none for a new one.
    """

    name: BesideImage
    shape: tuple[int, ...]
    scale: tuple[float, ...] = ()
    offset: tuple[float, ...] = (0.0,)
    objects: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Numbers of one frame."""
        return math.prod(self.shape)


@dataclass(frozen=True, slots=True)
class VisionInput:
    """A camera whose images the network sees: its name, size, intrinsics and pose in training.

    ``k_px`` and ``t_world_camera_mm`` are the matrices of ``Camera``, row after row.
    """

    camera: str
    shape_px: tuple[int, int]
    k_px: tuple[float, ...]
    t_world_camera_mm: tuple[float, ...]

    @classmethod
    def of(cls, camera: Camera) -> "VisionInput":
        """That of a dataset's camera."""
        k_px, pose = camera.k_px.ravel().tolist(), camera.t_world_camera_mm.ravel().tolist()
        return cls(camera.name, camera.shape_px, tuple(k_px), tuple(pose))


@dataclass(frozen=True, slots=True)
class InputSpec:
    """How images become input; kept with the model, so that evaluation does the same.

    ``size_px`` (height, width) is what images are resized to, ``n_frames`` how many of a sequence
    are taken, spread evenly (1 for a single image). ``image`` says what is subtracted: the image of
    the undeformed gel (``difference``), the frame before (``change``; of the first frame: the
    undeformed gel), or nothing (``raw``). Images of another size than ``source_shape_px`` are
    refused. ``normalised`` removes each image's gain and each grasp's contrast: sensors differ in
    them. ``mean`` and ``std`` are those of the training images, by channel: the input is
    (image − mean) / std. ``until`` says whether a sequence ends before the lift or shows it,
    ``touch`` what the network sees beside the image. ``vision`` is the camera that it sees, whose
    colours follow the sensor's, and are never subtracted from; without ``sees_touch`` the camera's
    alone.
    """

    kind: Literal["single", "sequence"]
    size_px: tuple[int, int]
    n_frames: int
    image: Literal["difference", "change", "raw"]
    source_shape_px: tuple[int, int]
    mean: tuple[float, ...] = (0.0, 0.0, 0.0)
    std: tuple[float, ...] = (1.0, 1.0, 1.0)
    normalised: bool = False
    until: Until = "outcome"
    touch: tuple[TouchInput, ...] = ()
    vision: VisionInput | None = None
    sees_touch: bool = True

    @property
    def n_images(self) -> int:
        """How many images of a frame the network sees, of three colours each."""
        return self.sees_touch + (self.vision is not None)

    @property
    def shows_until(self) -> Literal["grasp", "lift", "outcome"]:
        """The last that the network sees of a grasp."""
        return "grasp" if self.kind == "single" else self.until

    def frames_seen(self) -> str:
        """Which frames of a grasp the network sees, for a reader."""
        if self.kind == "single":
            return "the image at the moment of grasp (prediction)"
        if self.until == "lift":
            return f"up to {self.n_frames} images, none after the start of the lift (prediction)"
        return f"{self.n_frames} images over the whole recording, outcome and all (detection)"


def taken_otherwise(trained: Mapping[str, Any], now: Mapping[str, Any], kind: str) -> list[str]:
    """Which of ``ACROSS`` differ between two of ``Dataset.taken_with``, as far as both know it.

    A network of the ``kind`` ``single`` sees neither the frames' times nor where they end.
    """
    both = [name for name in trained if None not in (trained[name], now.get(name))]
    found = {name.removesuffix("_sha256") for name in both if trained[name] != now[name]}
    if kind == "single":
        found -= {"time_s", "until"}
    return [name for name in ACROSS if name in found]


def chosen_frames(spec: InputSpec, n_available: int, grasp_frame: int) -> list[int]:
    """Indices of the images of a grasp that the network sees."""
    if spec.kind == "single":
        return [min(max(grasp_frame, 0), n_available - 1)]
    count = min(spec.n_frames, n_available)
    return [int(frame) for frame in np.round(np.linspace(0, n_available - 1, count))]


def check_source(spec: InputSpec, source: GraspSource, rows: Iterable[int], where: str) -> None:
    """Check that a source's images are as the spec requires.

    Raises ``LearningError`` if they are of another size, or single images where a sequence is
    needed.
    """
    problems: list[str] = []
    if spec.vision is not None:
        problems += _camera_problems(spec.vision, source.camera(spec.vision.camera), where)
    if spec.sees_touch and source.shape_px != spec.source_shape_px:
        (height, width), (h, w) = source.shape_px, spec.source_shape_px
        problems.append(
            f"{where}: its images are {width}×{height} px, the model was trained on those of "
            f"{w}×{h} px; use the same sensor and image size"
        )
    if spec.kind == "sequence":
        ids = source.table.ids
        short = [str(ids[row]) for row in rows if frames_until(source, row, spec.until) < 2]
        if short:
            problems.append(
                f"{where}: {len(short)} grasps have a single image ({', '.join(short[:3])}, …), "
                "the sequence network needs two or more; use model.kind: single, or sequences"
            )
    for one in spec.touch:
        shape = one.shape if one.objects else touch_input(source, one.name).shape
        if shape != one.shape:
            problems.append(
                f"{where}: its {ARRAYS[one.name]} is of {_by(shape)} a frame, the model was "
                f"trained on {_by(one.shape)}; collect it with the same sensor and force_field"
            )
    LearningError.raise_if(problems)


def _camera_problems(trained: VisionInput, camera: Camera, where: str) -> Iterator[str]:
    found = VisionInput.of(camera)
    if found.shape_px != trained.shape_px:
        (height, width), (h, w) = found.shape_px, trained.shape_px
        yield (
            f"{where}: its camera {found.camera!r} has {width}×{height} px, the model was trained "
            f"on {w}×{h} px; collect it with the same scene"
        )


def camera_note(trained: VisionInput, camera: Camera) -> str:
    """Whether a camera looks otherwise than in training; empty where it does not."""
    found = VisionInput.of(camera)
    is_same = np.allclose(found.k_px, trained.k_px, rtol=1e-6)
    is_same &= np.allclose(found.t_world_camera_mm, trained.t_world_camera_mm, atol=1e-3)
    other = (
        f"the camera {found.camera!r} is not placed as in training, or has another angle of view"
    )
    return "" if is_same else f"{other}: the network has never seen the scene from there"


def _by(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))


def touch_input(
    source: GraspSource, channel: BesideImage, objects: Sequence[str] = ()
) -> TouchInput:
    """A channel beside the image, of a source and the ``objects`` to train on.

    Raises ``TacgenError`` if the source has no such channel.
    """
    if channel == "object":
        return TouchInput(channel, (len(objects),), objects=tuple(objects))
    return TouchInput(channel, source.touch(0, [0], ARRAYS[channel]).shape[1:])


def read_touch(source: GraspSource, row: int, spec: InputSpec) -> list[NDArray[np.float32]]:
    """Each channel beside the image in the frames of ``read_input``, (T, …) of its shape."""
    frames = frames_of(source, row, spec) if spec.touch else []
    return [
        one_of(one.objects, source.table.objects[row], len(frames))
        if one.objects
        else source.touch(row, frames, ARRAYS[one.name]).astype(np.float32)
        for one in spec.touch
    ]


def one_of(objects: Sequence[str], name: str, n_frames: int) -> NDArray[np.float32]:
    """A row a frame, (T, n), with a 1 for the object of that name."""
    return np.tile(np.array([one == name for one in objects], np.float32), (n_frames, 1))


def touch_to_network(found: list[NDArray[np.float32]], spec: InputSpec) -> NDArray[np.float32]:
    """The channels of ``read_touch`` as the network's input, (T, n) float32."""
    parts = zip(found, spec.touch, strict=True)
    scaled = [
        (part - np.asarray(one.offset, np.float32)) / np.asarray(one.scale, np.float32)
        for part, one in parts
    ]
    return np.concatenate([part.reshape(len(part), -1) for part in scaled], axis=1)


def with_touch_scale(spec: InputSpec, inputs: Iterable[list[NDArray[np.float32]]]) -> InputSpec:
    """The spec with the scales of the ``inputs``, each as of ``read_touch``."""
    touch = []
    for one, found in zip(spec.touch, zip(*inputs, strict=True), strict=False):
        values = np.concatenate(
            [part.astype(np.float64).reshape(-1, one.shape[-1]) for part in found]
        )
        if one.name == "commanded":
            one = replace(one, offset=tuple(values.mean(axis=0).tolist()))
        rms = np.sqrt(np.square(values - one.offset).mean(axis=0))
        touch.append(replace(one, scale=tuple(np.where(rms > MIN_RMS, rms, 1.0).tolist())))
    return replace(spec, touch=tuple(touch))


def resized(images: NDArray[np.uint8], size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """(T, H, W, 3) images at (height, width); shrunk by averaging areas."""
    if images.shape[1:3] == size_px:
        return images
    smaller = size_px[0] <= images.shape[1] and size_px[1] <= images.shape[2]
    how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
    return np.stack([cv2.resize(image, size_px[::-1], interpolation=how) for image in images])


def read_input(source: GraspSource, row: int, spec: InputSpec) -> NDArray[np.uint8]:
    """The frames of one grasp at the network's size, (T, h, w, 3), or 6 with touch and vision."""
    found = [_read_touch_images(source, row, spec)] if spec.sees_touch else []
    if spec.vision is not None:
        frames = source.vision(row, frames_of(source, row, spec), spec.vision.camera)
        found.append(resized(frames, spec.size_px))
    return found[0] if len(found) == 1 else np.concatenate(found, axis=-1)


def _read_touch_images(source: GraspSource, row: int, spec: InputSpec) -> NDArray[np.uint8]:
    count, grasp_frame = source.frame_count(row), int(source.table.grasp_frame[row])
    if spec.kind == "single" and count > 1 and grasp_frame == FRAME_UNKNOWN:
        # How long the gripper closes differs from grasp to grasp: the images show when it has.
        frames = resized(source.frames(row, range(count)), spec.size_px)
        reference = source.reference
        rest = frames[0] if reference is None else resized(reference[None], spec.size_px)[0]
        return frames[[pressed_frame(frames, rest)]]
    return resized(source.frames(row, frames_of(source, row, spec)), spec.size_px)


def frames_of(source: GraspSource, row: int, spec: InputSpec) -> list[int]:
    """Indices of the images of a source's grasp that the network sees."""
    count = frames_until(source, row, spec.until)
    return chosen_frames(spec, count, int(source.table.grasp_frame[row]))


def pressed_frame(frames: NDArray[np.uint8], rest: NDArray[np.uint8]) -> int:
    """The first of the frames (T, h, w, 3) where the difference from ``rest`` stops growing.

    It is at least half of the largest, which a slip may make later, and 95 % of the largest within
    the next eighth of the sequence.
    """
    change = np.abs(frames.astype(np.float32) - rest.astype(np.float32)).mean(axis=(1, 2, 3))
    window = max(1, len(frames) // 8)
    soon = maximum_filter1d(change, window + 1, origin=-((window + 1) // 2), mode="nearest")
    settled = (change >= 0.5 * change.max()) & (change >= PRESSED_FRACTION * soon)
    return int(np.argmax(settled))


def to_network(
    frames: NDArray[np.uint8], reference: NDArray[np.uint8] | None, spec: InputSpec
) -> NDArray[np.float32]:
    """Frames (B, T, h, w, 3 or 6) as the network's input, float32 of the same shape.

    ``reference`` (h, w, 3) is the undeformed gel at the same size; not needed for ``raw``. A
    camera's colours, the last three, are normalised alone. Where
    the spec is ``normalised``, the median over the pixels of an image's ratio to it is the gain of
    a channel, and the largest root mean square difference of a grasp's frames is its contrast.
    Raises ``LearningError`` if the reference is missing.
    """
    everything = frames.astype(np.float32)
    images = everything[..., : 3 * spec.sees_touch]  # a view: what is done to it is done to all
    if spec.image != "raw" and spec.sees_touch:
        if reference is None:
            msg = "no image of the undeformed gel to subtract; add background.png"
            raise LearningError(msg)
        rest = reference.astype(np.float32)
        if spec.normalised:
            gain = np.median(images / np.maximum(rest, 1), axis=(2, 3), keepdims=True)
            images /= np.maximum(gain, MIN_GAIN)
        images -= rest
        if spec.normalised:
            contrast = np.sqrt(np.square(images).mean(axis=(2, 3, 4), keepdims=True))
            images /= contrast.max(axis=1, keepdims=True) + FAINT_GREY
    if spec.image == "change":
        images[:, 1:] -= images[:, :-1].copy()
    everything -= np.asarray(spec.mean, np.float32)
    everything /= np.asarray(spec.std, np.float32)
    return everything


def with_normalisation(
    spec: InputSpec, inputs: Iterable[NDArray[np.uint8]], reference: NDArray[np.uint8] | None
) -> InputSpec:
    """The spec with the mean and spread of the ``inputs``, each (T, h, w, 3 or 6)."""
    n = 3 * spec.n_images
    plain = replace(spec, mean=(0.0,) * n, std=(1.0,) * n)
    scaler = StandardScaler()
    for frames in inputs:
        scaler.partial_fit(to_network(frames[None], reference, plain).reshape(-1, n))
    std = np.sqrt(np.maximum(scaler.var_, MIN_STD**2))
    return replace(spec, mean=tuple(scaler.mean_.tolist()), std=tuple(std.tolist()))


def at_rest(reference: NDArray[np.uint8] | None, spec: InputSpec) -> NDArray[np.uint8] | None:
    """The undeformed gel (h, w, 3) with what a camera's colours move from, black, beside it.

    None where no image of the gel is seen, or none is known.
    """
    if reference is None or not spec.sees_touch or spec.n_images == 1:
        return reference if spec.sees_touch else None
    return np.concatenate([reference, np.zeros_like(reference)], axis=-1)


def augmented(
    frames: NDArray[np.uint8],
    reference: NDArray[np.uint8] | None,
    options: Augmentation,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    """One grasp's frames (T, h, w, n) as another camera might have seen it a little further on.

    All frames change alike. The imprint moves and changes its contrast and sharpness, the
    illumination of the gel at rest does not; what a shift brings in from outside repeats the edge.
    Where the undeformed gel, ``reference`` (h, w, n), is not known, the whole image moves.
    """
    height, width, n = frames.shape[1:]
    shift = rng.uniform(-1, 1, 2) * options.shift_fraction * (height, width)
    dy, dx = (int(step) for step in np.rint(shift))
    gain = (1 + options.gain_relative * rng.standard_normal((n,))).astype(np.float32)
    contrast = (1 + options.imprint_relative * rng.standard_normal((n,))).astype(np.float32)
    blur_px = rng.uniform(0, options.blur_px)
    noise = options.noise_grey * rng.standard_normal(frames.shape, dtype=np.float32)
    ys = np.clip(np.arange(height) - dy, 0, height - 1)
    xs = np.clip(np.arange(width) - dx, 0, width - 1)
    rest = np.float32(0) if reference is None else reference.astype(np.float32)
    imprint = contrast * (frames - rest)[:, ys][:, :, xs]
    if blur_px > 0:
        imprint = gaussian_filter(imprint, (0, blur_px, blur_px, 0), mode="nearest")
    return np.clip(np.rint(gain * (rest + imprint) + noise), 0, 255).astype(np.uint8)
