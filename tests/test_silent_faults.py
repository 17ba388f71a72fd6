"""What must never be wrong silently: every case by kind, what is given and what must happen.

A row names the test that proves it, by its node id, or is run here where that costs next to
nothing. A new case is one more row.
"""
# ruff: noqa: E501

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tacgen
from tacgen.core.errors import TacgenError
from tacgen.presses.press_log import read_press_log

ROOT = Path(__file__).resolve().parents[1]

KINDS = (
    "one reader of images",
    "calibration carries its meaning",
    "what is pressed is what touches",
    "validity is part of the result",
    "units and frames are checked where they enter",
    "own logs get in",
    "meshes as people have them",
    "objects at rest",
    "heuristics warn, proofs refuse",
    "exports hold everything",
    "versions",
    "files made to harm",
    "messages",
)


@dataclass(frozen=True)
class Given:
    """A cheap case: what ``act`` returns, or the text of its refusal, holds ``says``."""

    act: Callable[[Path], object]
    says: str


@dataclass(frozen=True)
class Row:
    """One case: its kind (from 1), what is given, what must happen, and what proves it."""

    kind: int
    given: str
    must: str
    proof: str | Given


def _law(text: str) -> Callable[[Path], object]:
    def act(folder: Path) -> object:
        path = folder / "contact.yaml"
        path.write_text(f"law: volume_linear\n{text}\n")
        return f"k_n = {tacgen.load_law(path).k_n_mm3_per_n.value:g}"

    return act


def _recipe(text: str) -> Callable[[Path], object]:
    def act(folder: Path) -> object:
        path = folder / "own.yaml"
        path.write_text(f"name: own\nobjects: [sugar_box]\ngrid: {{sample: 3}}\n{text}\n")
        return tacgen.load_recipe(path)

    return act


def _log(force: str = "F", **factors: float) -> Callable[[Path], object]:
    """A log of three presses in other units; what its force, volume and time are times."""

    def act(folder: Path) -> object:
        force_n = np.tile(np.concatenate([np.linspace(0, 4, 20), np.linspace(4, 0, 20)]), 3)
        column = {"F": force_n, "V": 5.0 * force_n, "t": 0.1 * np.arange(120.0)}
        column = {name: values * factors.get(name, 1.0) for name, values in column.items()}
        rows = zip(np.repeat([1, 2, 3], 40), column["t"], column["F"], column["V"], strict=True)
        lines = [f"{k},{t},{f + 1e-4 * k},{v}" for k, t, f, v in rows]
        path = folder / "log.csv"
        path.write_text("\n".join([f"Press,Time,{force},Volume", *lines]))
        log = read_press_log(path)
        loaded = log["force_normal_n"] > 1.0
        k_n = np.median(log["volume_mm3"][loaded] / log["force_normal_n"][loaded])
        return "\n".join([f"k_n = {k_n:.2f}", *log.warnings])

    return act


FOREIGN = "tests/presses/test_foreign_logs.py"
READ = f"{FOREIGN}::test_what_a_laboratory_writes_is_read_as_it_was_measured"
REFUSED = f"{FOREIGN}::test_what_cannot_be_right_is_refused_with_the_option_that_mends_it"
LAB = "tests/presses/test_lab_logs.py"
IMAGES = "tests/sensor/test_read_image.py"
HOSTILE = "tests/test_hostile_files.py"
BODIES, REST, ADD = (f"tests/objects/test_{name}.py" for name in ("bodies", "rest", "add"))
SIMULATED = "tests/sensor/test_simulated.py"
TOUCH, BESIDE = "tests/sensor/test_touch.py", "tests/contact/test_beside_the_window.py"
FOLDER, SETS = "tests/presses/test_press_folder.py", "tests/presses/test_measured_presses.py"
VALIDITY, EXPORTS = "tests/dataset/test_validity.py", "tests/dataset/test_export_formats.py"

ROWS = [
    # one reader of images
    Row(1, "lamps drift in one colour or all, a gain", "the same force", f"{IMAGES}::test_drift_of_the_lamps_changes_nothing"),
    Row(1, "a gel at rest under other lamps", "no contact", f"{IMAGES}::test_a_gel_at_rest_shows_no_contact_in_any_light"),
    Row(1, "BGR, turned, mirrored, zoomed", "refused: another view", f"{IMAGES}::test_another_view_is_refused"),
    Row(1, "shifted by 10 and 20 px", "refused, or the error covers it", f"{IMAGES}::test_a_shifted_picture_is_refused_or_its_error_covers_it"),
    Row(1, "real presses of known depth", "their volumes", f"{IMAGES}::test_real_balls_of_known_depth"),
    Row(1, "16-bit, float and transparent pictures", "8 bits, or refused with their range", "tests/presses/test_press_folder.py::test_grey_pictures_are_said"),
    # calibration carries its meaning
    Row(2, "colours of a virtual sensor", "called so", "tests/sensor/test_listing.py::test_what_is_virtual_is_called_so"),
    Row(2, "what calibrate lookup hands over", "a sensor that loads, with its dome", "tests/cli/test_habits.py::test_tables_hand_over_a_sensor_that_loads"),
    Row(2, "a table of another resolution", "refused with both", "tests/collection/test_pipeline.py::test_a_table_of_another_resolution_is_named_with_both"),
    Row(2, "an image of another size than the table", "refused", f"{IMAGES}::test_pictures_that_do_not_fit_are_refused"),
    # what is pressed is what touches
    Row(3, "a child link that touches", "pressed, with its force", f"{TOUCH}::test_a_child_link_that_touches_is_pressed"),
    Row(3, "a child body that touches", "pressed, with its force", f"{TOUCH}::test_a_child_body_that_touches_is_pressed"),
    Row(3, "geoms for show", "not pressed", f"{TOUCH}::test_geoms_that_do_not_touch_the_gel_are_not_pressed"),
    Row(3, "a rib beside the window", "no imprint: outside_window", f"{TOUCH}::test_a_plate_on_ribs_beside_the_window_leaves_no_imprint"),
    Row(3, "a ball held above the gel", "no imprint", f"{TOUCH}::test_a_ball_that_studs_hold_above_the_gel_leaves_no_imprint"),
    Row(3, "a face larger than the gel", "the window's share of the force", f"{BESIDE}::test_a_face_larger_than_the_gel_shares_its_force_by_area"),
    Row(3, "a grip at the pad's rim", "no other surface", "tests/collection/test_pipeline.py::test_a_grip_at_the_pads_rim_shows_no_other_surface"),
    Row(3, "a ball that was moved away since the step", "it does not press", f"{SIMULATED}::test_what_was_moved_away_since_the_step_does_not_press"),
    Row(3, "substeps of the engine", "the whole force", f"{SIMULATED}::test_substeps_of_pybullet_do_not_divide_the_force"),
    Row(3, "an object beside the pad", "the gel at rest", "tests/sensor/test_tactile_pad.py::test_an_object_beside_the_pad_leaves_the_picture_of_the_gel_at_rest"),
    # validity is part of the result
    Row(4, "a gel that is pressed through", "saturated", f"{TOUCH}::test_a_load_that_presses_the_gel_through_is_saturated"),
    Row(4, "frames of a dataset", "a flag each", f"{VALIDITY}::test_each_frame_of_a_shard_has_its_flags"),
    Row(4, "frames in the summary", "counted", f"{VALIDITY}::test_the_summary_counts_frames_and_grasps_at_their_moment"),
    Row(4, "frames on pages", "named", f"{VALIDITY}::test_the_pages_name_them"),
    Row(4, "frames in exports", "a flag each", f"{VALIDITY}::test_exports_have_them"),
    Row(4, "markers of a sensor without any", "refused", "tests/collection/test_recipe.py::test_markers_of_a_sensor_without_any_are_refused"),
    Row(4, "no contact", "zero force, and so it says", f"{IMAGES}::test_no_contact_is_zero_force_and_says_so"),
    Row(4, "walls steeper than the table", "a lower bound, and so it says", f"{IMAGES}::test_walls_steeper_than_the_table_are_reported"),
    Row(4, "a force that cannot be", "refused", f"{SIMULATED}::test_a_force_that_cannot_be_is_refused"),
    # units and frames are checked where they enter
    Row(5, "k_n of a law in mm³/mN", "asked: 0.3 to 60", Given(_law("k_n_mm3_per_n: 0.005135"), "= 0.005135: gels have 0.3 to 60 mm³/N")),
    Row(5, "k_n of a law in px³/N", "asked: 0.3 to 60", Given(_law("k_n_mm3_per_n: 200039"), "so another unit is likely")),
    Row(5, "a law that states its unit", "read as it says", Given(_law("k_n_mm3_per_n: {value: 0.2, unit: mm3/N}"), "k_n = 0.2")),
    Row(5, "a law in another unit", "refused", Given(_law("k_n_mm3_per_n: {value: 5.1e-9, unit: m3/N}"), "unit = 'm3/N' is not mm3/N; convert the value")),
    Row(5, "k_n of a recipe in mm³/kN", "asked: 0.3 to 60", Given(_recipe("contact: {k_n_mm3_per_n: 5135}"), "own.yaml:4: contact.k_n_mm3_per_n = 5135: gels have")),
    Row(5, "forces in mN", "refused: --force-unit mn first", Given(_log(F=1e3), "give --force-unit mn (millinewtons: 5 mm³/N)")),
    Row(5, "forces in mN that the header states", "k_n = 5", Given(_log("Force [mN]", F=1e3), "k_n = 5.00")),
    Row(5, "forces in kgf", "asked: another unit?", Given(_log(F=1 / 9.80665), "If so, give --force-unit kgf (kg: 5 mm³/N)")),
    Row(5, "depths in m", "refused: --column depth_mm", f"{REFUSED}[m]"),
    Row(5, "depths in cm", "refused: --column depth_mm", f"{REFUSED}[cm]"),
    Row(5, "volumes in m³", "refused: --column volume_mm3", Given(_log(V=1e-9), '--column volume_mm3="Volume [m3]" (m3: 5 mm³/N)')),
    Row(5, "times in ns", "refused: --column time_s", Given(_log(t=1e9), '--column time_s="Time [ns]"')),
    Row(5, "times in ms", "asked: in ms?", Given(_log(t=1e3), 'if it is in ms, say which it is: --column time_s="Time [ms]"')),
    Row(5, "a stage's position for a depth", "refused: count it from the gel", f"{REFUSED}[a stage's position]"),
    Row(5, "a ball's diameter for its radius", "halved, and so it says", f"{FOREIGN}::test_the_diameter_of_a_ball_is_no_radius"),
    Row(5, "pictures stretched by 8 %", "a warning: no squares", "tests/calibrate/lookup/test_scale.py::test_pixels_that_are_no_squares_are_said"),
    Row(5, "a stated scale that is off", "a warning: by 10 %", "tests/calibrate/lookup/test_scale.py::test_a_stated_scale_that_is_off_is_said"),
    Row(5, "a mesh in metres", "refused with the scale", f"{ADD}::test_metres_taken_for_millimetres_are_refused_with_the_scale_that_mends_it"),
    Row(5, "a mass in grams", "refused", f"{ADD}::test_grams_for_kilograms_are_refused"),
    Row(5, "heights in m, angles in degrees", "asked", "tests/collection/test_recipe.py::test_metres_and_degrees_are_suspected"),
    # own logs get in
    Row(6, "44 programs' files of the same presses", "the same presses", READ),
    Row(6, "units, decimal commas, delimiters", "converted, and so it says", f"{LAB}::test_delimiters_and_decimal_marks"),
    Row(6, "comment lines, a preamble", "passed over", f"{LAB}::test_lines_above_the_header_and_comments_between_rows"),
    Row(6, "negative forces", "refused: --flip force", f"{LAB}::test_negative_readings_say_which_sign_to_flip"),
    Row(6, "shuffled rows", "sorted, and so it says", f"{LAB}::test_shuffled_rows_are_sorted"),
    Row(6, "most samples cannot be used", "refused with the reasons", f"{LAB}::test_a_log_of_which_most_is_dropped_is_an_error"),
    Row(6, "two columns for one quantity", "asked: --column", f"{LAB}::test_two_columns_for_one_quantity_are_asked_about"),
    Row(6, "presses without numbers", 'refused: --column trial="pauses"', f"{REFUSED}[pauses]"),
    Row(6, "every option that a refusal names", "mends the file", f"{FOREIGN}::test_the_option_that_is_named_mends_it"),
    Row(6, "what calibrate contact reads", "diagnose contact reads", f"{FOREIGN}::test_both_commands_read_one_log"),
    Row(6, "one press in kgf", "left out, and so it says", f"{FOREIGN}::test_one_press_in_kgf_is_left_out_and_said"),
    Row(6, "a gauge that was not tared", "its zero is subtracted, and so it says", "tests/calibrate/contact/test_rest_zero.py::test_a_gauge_that_was_not_tared"),
    Row(6, "each reading in several rows", "used once, and so it says", "tests/presses/test_independent_rows.py::test_the_first_row_of_a_reading_that_stands_is_kept"),
    # meshes as people have them
    Row(7, "a scan without its bottom", "closed, and what changed is said", f"{BODIES}::test_a_scan_without_its_bottom_is_closed_and_what_changed_is_said"),
    Row(7, "a strip with one side", "refused", f"{BODIES}::test_a_strip_with_one_side_is_refused"),
    Row(7, "a container without thickness", "refused", f"{ADD}::test_a_container_without_thickness_is_refused"),
    Row(7, "a URDF with several links", "each where its joints put it", "tests/objects/test_urdf.py::test_links_are_where_their_joints_put_them"),
    Row(7, "suggested places that fail", "not written", f"{ADD}::test_the_largest_grid_without_bad_places_is_kept"),
    Row(7, "an inverted handle", "its mass all the same", f"{BODIES}::test_the_handle_adds_its_mass_whichever_way_its_faces_look"),
    Row(7, "a closed hollow box", "hollow", f"{BODIES}::test_a_closed_cavity_stays_hollow"),
    Row(7, "two bodies apart, one inverted", "both", f"{BODIES}::test_two_bodies_apart_of_which_one_is_inverted"),
    Row(7, "slivers", "no holes", f"{BODIES}::test_slivers_are_no_holes"),
    Row(7, "a hole", "filled, with its size", f"{BODIES}::test_a_hole_is_filled_and_said_with_its_size"),
    Row(7, "a symbolic link", "read", f"{BODIES}::test_a_link_to_a_mesh_is_read"),
    Row(7, "a GLB, whose y is up", "z is up", f"{REST}::test_a_glb_points_up_with_its_y_axis"),
    Row(7, "a mug with its handle anywhere", "grasped as suggested", f"{REST}::test_a_mug_can_be_grasped_as_suggested_wherever_its_handle_points"),
    Row(7, "a folder of meshes", "added, and what is refused is said", f"{ADD}::test_a_folder_of_meshes_is_added_and_what_is_refused_is_said"),
    # objects at rest
    Row(8, "a grasp of what does not stand", "status toppled, with the reason", "tests/physics/test_toppling.py::test_a_grasp_of_it_has_the_status_toppled_and_says_why"),
    Row(8, "a box that leans", "falls as its centre of mass lies", f"{REST}::test_a_leaning_box_falls_back_before_and_over_beyond_its_critical_angle"),
    Row(8, "an overhang", "topples and lies flat", f"{REST}::test_an_overhang_topples_to_its_hull_and_lies_flat"),
    Row(8, "an import that does not stand", "rested, and so it says", f"{REST}::test_the_import_rests_it_and_says_how"),
    # heuristics warn, proofs refuse
    Row(9, "real sets, whole and in part", "none refused", f"{SETS}::test_no_part_of_a_real_set_is_refused"),
    Row(9, "real sets of another view", "refused", f"{SETS}::test_another_view_is_refused"),
    Row(9, "what is odd about a press", "a warning; only what is certain drops it", f"{FOLDER}::test_what_is_certain_drops_a_press_and_what_is_odd_warns"),
    Row(9, "a label where nothing is seen", "contradicts the picture", f"{FOLDER}::test_a_label_where_nothing_is_seen_contradicts_the_picture"),
    Row(9, "a faint contact in the background", "no reason to refuse", "tests/presses/test_press_folder.py::test_a_faint_contact_does_not_make_a_press_of_the_background"),
    Row(9, "a background of another sensor", "refused", "tests/presses/test_press_folder.py::test_a_background_that_is_not_of_these_presses"),
    # exports hold everything
    Row(10, "two pads in folders of pictures", "both", f"{EXPORTS}::test_folders_of_pictures_hold_both_pads"),
    Row(10, "two pads in Python", "both", f"{EXPORTS}::test_a_grasp_in_python_has_both_pads"),
    Row(10, "24 frames in 3 s to LeRobot", "their own times", "tests/dataset/test_lerobot.py::test_timestamps_are_the_times_of_the_frames"),
    Row(10, "depth once a grasp", "and so it says", f"{EXPORTS}::test_exports_say_what_there_is_of_depth"),
    Row(10, "two pads to LeRobot", "two cameras", "tests/dataset/test_lerobot.py::test_two_pads_are_two_cameras"),
    Row(10, "images of frames", "with forces and depth", "tests/dataset/test_export_formats.py::test_images_hold_frames_forces_and_depth"),
    # versions
    Row(11, "a network of a newer tacgen", "made by a newer tacgen; upgrade", "tests/learning/test_predictor.py::test_a_run_of_a_newer_tacgen_says_so"),
    Row(11, "a table of a newer tacgen", "made by a newer tacgen; upgrade", f"{HOSTILE}::test_a_table_of_a_newer_tacgen_says_so"),
    Row(11, "a manifest or plan of a newer tacgen", "made by a newer tacgen; upgrade", f"{HOSTILE}::test_plans_of_datasets"),
    Row(11, "a run of another version", "refused", "tests/learning/test_evaluate.py::test_a_plan_that_is_not_of_this_version_is_refused"),
    # files made to harm
    Row(12, "YAML tags, bombs, sixties, surrogates", "refused, with the place", f"{HOSTILE}::test_yaml"),
    Row(12, "a table's header broken, deep, lacking", "refused", f"{HOSTILE}::test_table_headers"),
    Row(12, "a table with other values in its header", "refused, with the key", f"{HOSTILE}::test_values_in_table_headers"),
    Row(12, "a table that unpacks to gigabytes", "refused before it is unpacked", f"{HOSTILE}::test_a_table_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked"),
    Row(12, "pickles in arrays and checkpoints", "not run", f"{HOSTILE}::test_no_pickle_is_run"),
    Row(12, "an endless log, cell, row or picture", "refused by its size", f"{HOSTILE}::test_files_without_end"),
    Row(12, "HDF5 that links to other files", "refused", "tests/dataset/test_verify.py::test_links_to_other_files_are_refused"),
    Row(12, "a picture set that links, loops, swells", "left out, and so it says", f"{HOSTILE}::test_pictures_in_hdf5_that_are_none"),
    Row(12, "a manifest of 10¹⁵ grasps", "refused", f"{HOSTILE}::test_lines_of_manifests"),
    Row(12, "an OBJ of one line, a GLB that unfolds", "refused", f"{HOSTILE}::test_glb_scenes_that_unfold"),
    Row(12, "forces of 10⁶ and 10³⁰⁸ N", "refused", f"{HOSTILE}::test_forces_beyond_any_gripper"),
    Row(12, "every reader, files spoiled at random", "read or refused", "tests/fuzz/test_readers.py::test_spoiled_files_are_read_or_refused"),
    Row(12, "scripts in names of a log", "text on every page", f"{FOREIGN}::test_no_page_runs_what_a_log_is_named"),
    Row(12, "a script in a recipe's description", "text on the gallery", "tests/dataset/test_pages.py::test_names_in_a_gallery_are_shown_not_run"),
    Row(12, "paths that lead out of an imported set", "refused", "tests/presses/test_import_formats.py::test_names_that_lead_out_of_the_set_are_refused"),
    Row(12, "letters that steer a terminal", "shown as escapes", f"{HOSTILE}::test_messages_neither_steer_the_terminal_nor_fill_it"),
    # messages
    Row(13, "a grey picture for a network of colours", "refused", "tests/learning/test_predictor.py::test_grey_pictures_are_refused"),
    Row(13, "a picture of another size", "refused with its name", "tests/learning/test_predictor.py::test_a_picture_of_another_size_is_named"),
    Row(13, "a key of another section", "its whole name", "tests/collection/test_recipe.py::test_a_part_of_a_key_hints_the_key"),
    Row(13, "an animation in the place of a file", "refused", "tests/cli/test_collect_folders.py::test_an_animation_does_not_replace_a_file"),
]  # fmt: skip


@cache
def _tests_in(path: Path) -> frozenset[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.kind}-{row.given}")
def test_what_must_never_be_wrong_silently(tmp_path, row):
    assert 1 <= row.kind <= len(KINDS)
    assert row.given
    assert row.must
    if isinstance(row.proof, Given):
        try:
            found = str(row.proof.act(tmp_path))
        except TacgenError as error:
            found = str(error)
        assert row.proof.says in found
        return
    name, _, parameters = row.proof.partition("[")
    file, _, function = name.partition("::")
    assert (ROOT / file).is_file(), file
    assert function.rpartition("::")[2] in _tests_in(ROOT / file), row.proof
    if parameters:
        assert f'"{parameters[:-1]}"' in (ROOT / file).read_text(encoding="utf-8")


def test_no_case_is_listed_twice_and_every_kind_has_one():
    assert len({(row.kind, row.given) for row in ROWS}) == len(ROWS)
    assert {row.kind for row in ROWS} == set(range(1, len(KINDS) + 1))
