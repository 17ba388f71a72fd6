"""Joining the stages: the law, the object and the calibration files that a recipe names."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.gel import contact_law
from tacgen.collection.grid import plan_recipe
from tacgen.collection.perturbed import recipe_object
from tacgen.collection.pipeline import GraspPipeline, dataset_spec, tactile_pad
from tacgen.collection.recipe import Contact, Grid, ObjectEntry, Recipe, load_recipe
from tacgen.contact.gel_response import gel_loads
from tacgen.core.errors import TableError
from tacgen.core.resources import packaged
from tacgen.sensor.tactile_pad import TactilePad
from tests.messages import refused


def test_a_shipped_contact_law_is_found_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = load_recipe("perturbed/other")
    assert contact_law(recipe.contact).effects
    assert set(dataset_spec(recipe, 10).calibration) == {"table", "contact_law"}


def test_a_table_of_another_resolution_is_named_with_both():
    choice = {"name": "digit", "table": str(packaged("recipes") / "sensors/gelsight.table.npz")}
    recipe = Recipe.model_validate({"name": "r", "objects": ["cup"], "sensor": choice})
    with refused(TableError):
        tactile_pad(recipe)


def test_a_recipe_overrides_what_the_object_says():
    plain = recipe_object(ObjectEntry(name="sugar_box"))
    entry = ObjectEntry(
        name="sugar_box", friction=0.2, mass_kg=1.0, center_of_mass_offset_mm=(0, 0, 20)
    )
    changed = recipe_object(entry)
    assert (changed.friction, changed.mass_kg) == (0.2, 1.0)
    assert changed.center_of_mass_mm[2] - plain.center_of_mass_mm[2] == pytest.approx(20)
    assert changed.spinning_friction_mm is None
    declared = recipe_object(ObjectEntry(name="sugar_box", spinning_friction_mm=1.5))
    assert declared.spinning_friction_mm == 1.5


@pytest.mark.slow
def test_a_collision_margin_takes_the_contact_from_the_image_alone():
    """TACTO's: the image of a firm grasp is as without the gap, less 0.2 mm; of a weak one none."""
    found = {}
    for margin_mm in (0.0, 0.2):
        contact = Contact(law="linear_depth", k_depth_mm_per_n=0.05, collision_margin_mm=margin_mm)
        recipe = Recipe(
            name="margin",
            objects=(ObjectEntry(name="rubiks_cube"),),
            grid=Grid(force_n=(3.0, 12.0), y_mm=(9.0,), z_mm=(28.5,)),
            contact=contact,
        )
        with GraspPipeline(recipe) as pipeline:
            found[margin_mm] = [pipeline.sample(planned) for planned in plan_recipe(recipe)]
    for plain, lost, is_lost in zip(found[0.0], found[0.2], (True, False), strict=True):
        assert (lost.label, lost.rise_mm, lost.turn_rad) == (
            *(plain.label, plain.rise_mm, plain.turn_rad),
        )
        (before,), (after,) = plain.pads.values(), lost.pads.values()
        np.testing.assert_array_equal(after.force_normal_n, before.force_normal_n)
        closed_form = np.maximum(before.indentation_mm - 0.2, 0.0)
        np.testing.assert_allclose(after.indentation_mm, closed_form, atol=2e-5)
        assert (after.no_contact == is_lost).all()
        assert not before.no_contact.any()


@pytest.mark.slow
def test_frames_of_a_steady_hold_share_their_picture(monkeypatch):
    """Only its noise differs; and no picture differs from that of the exact pose and load."""
    recipe = Recipe.model_validate(
        {
            "name": "hold",
            "objects": ["rubiks_cube"],
            "grid": {"force_n": 12.0, "x_mm": 0.0, "y_mm": 1.0, "z_mm": 30.0},
            "frames": {"mode": "sequence", "count": 16},
        }
    )
    planned = plan_recipe(recipe)[0]
    with GraspPipeline(recipe) as pipeline:
        grasp = pipeline.simulate(planned)
        assert grasp.trace.label == 1
        clean, imprints = pipeline.render(grasp, "left")
        noisy, _ = pipeline.render(grasp, "left", rng=np.random.default_rng(1))
    shared = [now is before for before, now in itertools.pairwise(imprints)]
    assert sum(shared) >= 4
    pad, rng = tactile_pad(recipe), np.random.default_rng(1)
    frames = grasp.trace.frames["left"]
    for k, (frame, load) in enumerate(zip(frames, gel_loads(pipeline._law, frames), strict=True)):
        # Another object of the same imprint is drawn anew.
        again = pad.image(replace(imprints[k]), rng=rng)
        np.testing.assert_array_equal(noisy[k], again)
        exact = pad.render(grasp.grasped.surface, frame.pose_gel_object, load)
        differs = np.abs(exact.astype(int) - clean[k])
        assert differs.max() <= 1
        assert differs.mean() < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_grip_at_the_pads_rim_shows_no_other_surface(engine):
    """The spatula's handle is 10.5 mm below the pads' middle there, beside the window.

    What is pressed is not the part of it in the window, which is 3 mm further away.
    """
    if engine == "pybullet":
        pytest.importorskip("pybullet")
    grid = {"force_n": 4.0, "x_mm": 0.0, "y_mm": -140.0, "z_mm": [14.0, 22.0]}
    sections = {"objects": ["spatula"], "grid": grid, "physics": {"engine": engine}}
    recipe = Recipe.model_validate({"name": "rim", "robot": {"tactile_pads": "both"}, **sections})
    with GraspPipeline(recipe) as pipeline:
        shown, beside = (pipeline.sample(planned).pads for planned in plan_recipe(recipe))
        at_rest = tactile_pad(recipe).at_rest_rgb
    for pad in ("left", "right"):
        assert [int(v[0]) for v in validity_of(shown[pad])] == [0, 0, 0]
        assert shown[pad].indentation_mm[0] > 0.3
        assert [int(v[0]) for v in validity_of(beside[pad])] == [0, 0, 1]
        assert beside[pad].indentation_mm[0] == 0.0
        assert beside[pad].force_normal_n[0] == pytest.approx(4.0, rel=0.03)
        assert abs(beside[pad].rgb[0].astype(int) - at_rest).mean() < 3.0  # the camera's noise


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_what_is_kept_of_the_touch_is_that_of_each_frame(engine, monkeypatch):
    """It has the frames' force; none is pressed from another frame's gel; old fields stay."""
    pytest.importorskip(engine)
    options = {"depth": "all", "markers": True, "force_field": [6, 8]}
    recipe = Recipe.model_validate(
        {
            "name": "touch",
            "objects": ["rubiks_cube"],
            "grid": {"force_n": 8.0, "x_mm": 0.0, "y_mm": 6.0, "z_mm": 30.0},
            "frames": {"mode": "sequence", "count": 5},
            "robot": {"tactile_pads": "both"},
            "physics": {"engine": engine},
            "dataset": options,
        }
    )
    given, gels = [], [None]
    press, advance = TactilePad.press, TactilePad.advance

    def spied_press(self, mesh, pose, load, before=None):
        given.append(before)
        return press(self, mesh, pose, load, before)

    def spied_advance(self, *arguments):
        gels.append(advance(self, *arguments))
        return gels[-1]

    monkeypatch.setattr(TactilePad, "press", spied_press)
    monkeypatch.setattr(TactilePad, "advance", spied_advance)
    spec = dataset_spec(recipe, 1)
    assert spec.layout.find("depth_mm").is_of_frames
    with GraspPipeline(recipe) as pipeline:
        sample = pipeline.sample(plan_recipe(recipe)[0])
    # Two frames of each pad are before the first step of its gel's past.
    assert sum(before is None for before in given) == 4
    assert all(any(before is gel for gel in gels) for before in given)
    height, width = spec.sensor.shape_px
    for pad in sample.pads.values():
        assert pad.depth_mm.shape == (5, height, width)
        assert pad.markers_mm.shape == (5, *spec.marker_rest_mm.shape)
        assert pad.force_field_n.shape == (5, 6, 8, 3)
        shown = pad.outside_window == 0
        force_n = np.column_stack([pad.force_shear_n, pad.force_normal_n])
        total_n = pad.force_field_n.sum(axis=(1, 2), dtype=float)
        off_n = np.linalg.norm(total_n - force_n, axis=1)
        # A frame that is not flagged shows 95 % of the force or more, and the field has that part.
        assert (off_n[shown] <= 0.05 * np.linalg.norm(force_n, axis=1)[shown] + 1e-6).all()
        touched = pad.no_contact == 0
        assert touched[-1]
        np.testing.assert_array_equal(pad.nothing_to_see, touched & (pad.visible_share == 0))
        assert (pad.outside_share.sum(axis=1) > 0.05)[~shown].all()
        np.testing.assert_array_equal(pad.depth_mm.any(axis=(1, 2)), touched)
        # The object's weight, which the pads carry after the lift, drags the gel along.
        down_n, moved_mm = pad.force_shear_n[-1], pad.markers_mm[-1].sum(axis=0)
        assert down_n @ moved_mm > 0.9 * np.linalg.norm(down_n) * np.linalg.norm(moved_mm)


def validity_of(pad):
    return pad.saturated, pad.no_contact, pad.outside_window


def test_the_gel_of_a_recipe_is_its_grippers_pad():
    """Along the image: the pads of wsg50 are 24 mm wide and 19 mm high."""
    recipe = Recipe.model_validate({"name": "r", "objects": ["cup"]})
    assert tactile_pad(recipe).sensor.gel_size_mm == (24.0, 19.0)
    digit = {"name": "r", "objects": ["cup"], "sensor": "digit", "robot": {"name": "franka_digit"}}
    assert tactile_pad(Recipe.model_validate(digit)).sensor.gel_size_mm == (16.0, 19.0)
