"""The gel of a grasp has its true past, whatever frames are kept."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.integrate import trapezoid

from tacgen.collection.gel import contact_law
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline, tactile_pad
from tacgen.collection.recipe import load_recipe
from tacgen.contact.gel_response import gel_loads
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.records import Estimate, GraspConfig
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp
from tests.physics.conftest import SEQUENCE, block
from tests.small_world import write_world

K_N = 5.0
CREEP = FittedEffect(
    "creep",
    "normal",
    MappingProxyType({"amount": Estimate(0.5), "tau_s": Estimate(2.0), "recovery": Estimate(1.0)}),
)
LAW = replace(ContactLaw.linear(K_N, 1.0, 2.0), effects=(CREEP,))
KEPT = (FrameRequest(), SEQUENCE, FrameRequest("sequence", 7, 1.5))


@pytest.fixture(scope="module", params=["pybullet", "mujoco"])
def traces(request):
    """One grasp with three choices of frames."""
    pytest.importorskip(request.param)
    settings = PhysicsSettings(tactile_pads="both", engine=request.param)
    config = GraspConfig(0, "block", 10.0, 0.0, 0.0, 50.0)
    with GraspSimulator("wsg50", request.param) as simulator:
        return [
            run_grasp(
                simulator, block(), config, settings, frames=frames, gel=GelModel(keeps_past=True)
            )
            for frames in KEPT
        ]


def test_a_past_does_not_depend_on_the_frames_that_are_kept(traces):
    for pad in ("left", "right"):
        frames = [frame for trace in traces for frame in trace.frames[pad]]
        course = max((frame.past for frame in frames), key=len)
        for frame in frames:
            np.testing.assert_array_equal(frame.past, course[: len(frame.past)])
            assert (frame.past[:, 0] < frame.time_s).all()
            assert frame.time_s - frame.past[-1:, 0].max(initial=0.0) < 0.02
        assert not course[0, 1:].any()


def test_what_the_grasp_does_does_not_depend_on_whether_a_past_is_kept(traces):
    settings = PhysicsSettings(tactile_pads="both")
    config = GraspConfig(0, "block", 10.0, 0.0, 0.0, 50.0)
    with GraspSimulator("wsg50") as simulator:
        pair = [
            run_grasp(
                simulator,
                block(),
                config,
                settings,
                frames=SEQUENCE,
                gel=GelModel(keeps_past=keeps),
            )
            for keeps in (False, True)
        ]
    assert pair[0].rise_mm == pair[1].rise_mm
    for one, other in zip(*(trace.frames["left"] for trace in pair), strict=True):
        assert one.past is None
        np.testing.assert_array_equal(one.pose_gel_object, other.pose_gel_object)
        assert one.force_normal_n == other.force_normal_n


def test_a_single_frame_has_crept_since_contact_alone(traces):
    """By the integral over the load's course: closing, most of the time, touches nothing."""
    (frame,) = traces[0].frames["left"]
    time_s = np.append(frame.past[:, 0], frame.time_s)
    force_n = np.append(frame.past[:, 1], frame.force_normal_n)
    fine_s = np.linspace(0.0, frame.time_s, 20001)
    load_n = np.interp(fine_s, time_s, force_n)
    delayed = trapezoid(load_n * np.exp((fine_s - frame.time_s) / 2.0) / 2.0, fine_s)
    expected = K_N * (frame.force_normal_n + 0.5 * delayed)
    (load,) = gel_loads(LAW, [frame])
    assert load.volume_mm3 == pytest.approx(expected, rel=1e-4)
    # As if it had come on evenly since closing began, as it was taken before.
    ramp = 0.5 * (1.0 - 2.0 / frame.time_s * -np.expm1(-frame.time_s / 2.0))
    crept = load.volume_mm3 / K_N / frame.force_normal_n - 1.0
    assert 0.0 < crept < 0.8 * ramp


FRAMES = (
    FrameRequest(),
    *(FrameRequest("sequence", count) for count in (1, 4, 13, 25)),
    FrameRequest("sequence", 5, 1.5),
    FrameRequest("sequence", 19, 0.6, "lift"),
    FrameRequest("sequence", 145, 0.6),  # each second step: one falls on the jerk of the lift
)


@pytest.fixture(scope="module")
def touches(tmp_path_factory):
    """Of a grasp that turns and one that holds: what each choice of frames shows, by its time.

    And how the held one's gel is after a single step from rest to its last load.
    """
    folder, found = tmp_path_factory.mktemp("frames"), ({}, {})
    path = write_world(
        folder,
        grid="{force_n: [11.2], y_mm: [-6, 0], z_mm: [60]}",
        dataset="{markers: true, force_field: [5, 7]}",
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        recipe = load_recipe(path)
        with GraspPipeline(recipe) as pipeline:
            for planned, shown in zip(plan_recipe(recipe), found, strict=True):
                for request in FRAMES:
                    grasp = pipeline.start(planned, frames=request).lift()
                    sample = pipeline.pad_samples(grasp)["left"]
                    fields = zip(sample.markers_mm, sample.force_field_n, strict=True)
                    for frame, both in zip(grasp.trace.frames["left"], fields, strict=True):
                        shown.setdefault(frame.time_s, []).append(both)
            frame = grasp.trace.frames["left"][-1]
            (load,) = gel_loads(
                contact_law(recipe.contact), [frame], friction=grasp.grasped.friction
            )
        pad = tactile_pad(recipe)
        imprint = pad.press(grasp.grasped.surface, frame.pose_gel_object, load)
    return *found, pad.marker_motion_mm(imprint)


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1], ids=["turns", "holds"])
def test_a_gel_at_one_moment_does_not_depend_on_the_frames_that_are_kept(touches, number):
    shared = [shown for shown in touches[number].values() if len(shown) > 1]
    assert len(shared) > 30
    assert max(len(shown) for shown in shared) == len(FRAMES) - 1  # at the moment of grasp
    for first, *others in shared:
        for markers_mm, field_n in others:
            np.testing.assert_array_equal(markers_mm, first[0])
            np.testing.assert_array_equal(field_n, first[1])


@pytest.mark.slow
def test_a_held_grasp_keeps_nothing_of_the_jerk_of_its_lift(touches):
    """Its gel is as after one step to the load that it hangs by, within what steps differ by."""
    *_, held, expected_mm = touches
    markers_mm, _ = held[0.6][0]
    assert np.abs(markers_mm - expected_mm).max() < 0.009 * np.abs(expected_mm).max()
