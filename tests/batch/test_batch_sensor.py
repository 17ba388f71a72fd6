"""A batch draws what ``Sensor`` draws, in arrays of any library, and refuses what it cannot."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh

import tacgen
from tacgen.cli.bench import batch_figures
from tacgen.contact import gap_map, solve_indentation
from tacgen.contact.gel_response import GelCourse, gel_loads
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.errors import ContactError, SensorError, TableError
from tacgen.core.records import ContactFrame, Estimate
from tacgen.objects import load_object
from tacgen.optics.table import save_table
from tacgen.sensor.simulated import as_mesh
from tacgen.sensor.tactile_pad import TactilePad
from validation.batch.frames import compare, random_frames

DEVICES = ["cpu", "warp:cpu", "cuda"]
"""Pads in threads; Warp's kernels on the CPU, for these tests; a GPU where there is one."""

BALL = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
LINEAR_DEPTH = ContactLaw(
    "linear_depth", Estimate(5.0), k_depth_mm_per_n=Estimate(0.1, 0.0, "mm/N")
)
CREEP = replace(
    ContactLaw.default(),
    effects=(FittedEffect("creep", "normal", {"amount": Estimate(0.4), "tau_s": Estimate(1.0)}),),
)


@pytest.fixture(params=DEVICES, scope="module")
def device(request):
    """Each device that is here."""
    if request.param != "cpu":
        warp = pytest.importorskip("warp")
        if request.param == "cuda" and not warp.is_cuda_available():
            pytest.skip("there is no CUDA GPU")
    return request.param


def skip_gpu(device):
    """The device, unless it is a GPU: the arrays of these tests are on the CPU."""
    if device == "cuda":
        pytest.skip("the arrays are on the CPU")
    return device


def make_batch(n=2, name="gelsight_mini", device="cpu", **options):
    return tacgen.BatchSensor(name, n, device, **options)


def balls(offsets_mm, description):
    """Gap maps (N, H, W) of balls over these places."""
    gaps = []
    for x, y in offsets_mm:
        pose = trimesh.transformations.translation_matrix((x, y, 0))
        gaps.append(gap_map(BALL.vertices, BALL.faces, pose, description))
    return np.stack(gaps)


@pytest.fixture(scope="module")
def pair(device):
    """A batch of two, and the gap maps of two balls."""
    sensor = make_batch(device=skip_gpu(device))
    return sensor, balls([(0, 0), (1.5, -1)], sensor.description)


def test_forces_are_those_of_one_sensor(device):
    """Within the window, half beside it, and nowhere near; the third with a force of 0 too."""
    sensor, batch = tacgen.Sensor("gelsight_mini"), make_batch(4, device=device)
    ball = trimesh.creation.icosphere(4, 8.0)
    half_mm = sensor.description.shape_px[1] * sensor.description.mm_per_px / 2
    poses = [trimesh.transformations.translation_matrix((x, 0, 8)) for x in (0, half_mm, 60, 1)]
    force_n, shear_n = (
        np.array([4.0, 3.0, 2.0, 0.0]),
        np.array([[0.5, -0.2], [0, 0.3], [0, 0], [0, 0]]),
    )
    ids = np.full(4, batch.add_mesh(ball))
    out = batch.render_meshes(ids, np.array(poses), force_n, shear_n)
    assert not out.total_force_n[2].any()
    for k in (0, 1, 3):
        frame = sensor.render(ball, poses[k], force_n[k], tuple(shear_n[k]))
        np.testing.assert_allclose(out.total_force_n[k], frame.total_force_n, atol=1e-9)
        # Grains of 2^-20 mm carry the share to 1e-4.
        np.testing.assert_allclose(out.force_n[k], frame.force_n, rtol=1e-4, atol=1e-9)
    assert 0.2 < out.force_n[1, 2] / out.total_force_n[1, 2] < 0.8
    gaps = np.full((4, *sensor.description.shape_px), np.inf, np.float32)
    assert not batch.render(gaps, force_n).total_force_n.any()
    assert np.isnan(batch.render_depth(np.zeros_like(gaps)).force_n).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gelsight_mini", "gelsight"])
def test_shear_moves_object_and_markers_as_of_one_sensor(name, device):
    can = load_object("tomato_soup_can").surface
    side = trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0))
    side[:3, 3] = -side[:3, :3] @ np.asarray(can.vertices_mm).mean(axis=0)
    move = trimesh.transformations.translation_matrix
    frames = [(0, move((1, 0, 0)), 4.0), (1, side, 8.0), (0, move((4, 3, 0)), 2.0),
              (0, np.eye(4), 3.0), (0, move((60, 0, 0)), 1.0)]  # fmt: skip
    shear_n = np.array([[1.0, -0.5], [2.0, 3.0], [-0.8, 0.0], [0.0, 0.0], [0.1, 0.0]])
    turn_n_mm = np.array([0.0, 5.0, -2.0, 0.0, 0.0])
    pulls = {"shear_n": shear_n, "turn": turn_n_mm}
    drawn = {"markers": True, "shadows": True}
    difference = compare(name, [BALL, can], frames, device=device, **pulls, **drawn)
    assert difference.most_grey <= 1
    assert difference.mean_grey <= 0.05
    assert difference.most_delta_mm <= 1e-6
    assert difference.other == []


def test_poses_in_metres_are_doubted():
    sensor = make_batch()
    ball, poses = sensor.add_mesh(BALL), two_poses()
    poses[0, 0, 3] = 0.004
    with pytest.warns(UserWarning, match="poses: no object moves by 0.004 mm.*in metres"):
        sensor.render_meshes([ball] * 2, poses, 1.0)


def test_a_course_of_shear_is_that_of_one_pad(device):
    """Pressed, pulled, turned, slid, left and pressed again: markers, poses and what remains."""
    sensor, pads = make_batch(3, markers=True, device=skip_gpu(device)), []
    description, law = sensor.description, sensor.law
    ball = sensor.add_mesh(BALL)
    for _ in range(3):
        pads.append(TactilePad(description, sensor.table, markers=True))
    solid, before = as_mesh(BALL), [None] * 3
    rng = np.random.default_rng(2)
    for step in range(8):
        at_mm = np.array([[0.1 * step, 0.0], [4.0, 1.0], [60.0 if step == 4 else 9.0, -6.5]])
        poses = np.stack([trimesh.transformations.translation_matrix((*at, 0)) for at in at_mm])
        force_n = np.array([2.0 + step, 5.0, 1.0 if step != 5 else 0.0])
        shear_n = rng.uniform(-0.6, 0.6, (3, 2)) * force_n[:, None]
        shear_n[1] = (0.7 * step, 0.0)  # from step 6 on more than friction holds
        turn = np.array([0.0, 3.0, -1.0]) * (step % 3 == 0)
        out = sensor.render_meshes([ball] * 3, poses, force_n, shear_n, turn, time_s=0.1 * step)
        assert out.slides.tolist() == (np.hypot(*shear_n.T) > 0.8 * force_n).tolist()
        for k, pad in enumerate(pads):
            frame = ContactFrame(0.1 * step, force_n[k], shear_n[k], turn[k], poses[k])
            before[k] = pad.press(solid, poses[k], gel_loads(law, [frame])[0], before[k])
            assert np.abs(out.markers_mm[k] - pad.markers_mm(before[k])).max() < 5e-5
            assert out.indentation_mm[k] == pytest.approx(before[k].indentation_mm, abs=1e-6)
            rgb = pad.image(before[k]).astype(int)
            assert np.abs(rgb - out.rgb[k]).max() <= 1
    assert out.slides[1]
    assert not sensor.render_depth(out.depth_mm.copy()).slides.any()
    assert before[0].shear is not None
    assert not np.array_equal(before[0].shear.sticks, before[0].shear.pressure > 0)  # some slips


def test_shear_by_a_law_with_effects(device):
    creep = FittedEffect("creep", "shear", {"amount": Estimate(0.5), "tau_s": Estimate(1.0)})
    law = replace(CREEP, effects=(*CREEP.effects, creep))
    sensor = make_batch(1, contact=law, markers=True, device=skip_gpu(device))
    course = GelCourse(law)
    pad, ball, before = (
        TactilePad(sensor.description, sensor.table, markers=True),
        as_mesh(BALL),
        None,
    )
    moved_mm = []
    mesh_id = sensor.add_mesh(ball)
    for step in range(3):
        frame = ContactFrame(0.5 * step, 4.0, np.array([1.0, 0.4]), 2.0, np.eye(4))
        out = sensor.render_meshes(
            [mesh_id], np.eye(4)[None], 4.0, [[1.0, 0.4]], 2.0, time_s=0.5 * step
        )
        before = pad.press(ball, np.eye(4), course.load(frame, 0.0), before)
        assert np.abs(out.markers_mm[0] - pad.markers_mm(before)).max() < 5e-5
        assert out.indentation_mm[0] == pytest.approx(before.indentation_mm, abs=1e-6)
        moved_mm.append(out.markers_mm[0, :, 0].sum(dtype=float))
    assert moved_mm[2] > moved_mm[0] + 0.1  # it goes on


@pytest.mark.exhaustive
@pytest.mark.slow
def test_kernels_compile_for_a_gpu_that_is_not_here(tmp_path):
    wp = pytest.importorskip("warp")
    from tacgen.batch import warp_kernels

    wp.compile_aot_module(warp_kernels, arch=90, module_dir=tmp_path, use_ptx=False)
    assert len(list(tmp_path.glob("*.cubin"))) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "shadows"),
    [("digit", True), ("gelsight", False), ("gelsight_mini", True), ("virtual_gelsight", False)],
)
def test_pictures_of_shipped_objects_are_those_of_one_sensor(name, shadows, device):
    objects = ["strawberry", "tomato_soup_can", "sugar_box", "scissors", "golf_ball"]
    meshes = [load_object(one).surface for one in objects]
    frames = random_frames(np.random.default_rng(7), meshes, 6)
    difference = compare(name, meshes, frames, device=device, shadows=shadows)
    assert difference.most_grey <= (0 if device == "cpu" else 1)
    assert difference.mean_grey <= 0.05
    assert difference.most_delta_mm <= 1e-6
    assert difference.other == []


@pytest.mark.parametrize(("shape_px", "mm_per_px"), [((77, 101), 0.12), ((160, 90), 0.03)])
def test_odd_sizes_and_contacts_at_the_edge(shape_px, mm_per_px, tmp_path, device):
    name = small_sensor(tmp_path, shape_px, mm_per_px)
    half_mm = mm_per_px * np.array(shape_px[::-1]) / 2
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5 * half_mm.min())
    places = [(0, 0), (half_mm[0], 0), (0, -half_mm[1]), (-half_mm[0], half_mm[1])]
    poses = np.stack([trimesh.transformations.translation_matrix((*at, 0)) for at in places])
    force_n = 0.02 * half_mm.min() ** 3 * np.array([0.1, 0.3, 1.0, 20.0])
    frames = [(0, pose, force) for pose, force in zip(poses, force_n, strict=True)]
    difference = compare(name, [ball], frames, device=device, shadows=True)
    assert difference.most_grey <= 1
    assert difference.most_delta_mm <= 1e-6
    assert difference.other == []


def small_sensor(folder, shape_px, mm_per_px, **changes):
    """A sensor of another size with the table of a GelSight Mini, whose file is returned."""
    table = tacgen.load_table(tacgen.Sensor("gelsight_mini").description.table)
    rows, columns = (np.linspace(0, n - 1, m).astype(int) for n, m in zip(
        table.shape_px, shape_px, strict=True))  # fmt: skip
    background = table.background[rows][:, columns]
    save_table(
        replace(table, background=background, mm_per_px=mm_per_px, **changes),
        folder / "table.npz",
    )
    path = folder / "small.yaml"
    path.write_text(
        f"name: small\nheight_px: {shape_px[0]}\nwidth_px: {shape_px[1]}\nmm_per_px: {mm_per_px}\n"
        "gel_depth_mm: 1.5\ntable: table.npz\n"
        "leds:\n  - {direction: [0.8, 0.1, -0.3], rgb: [1.5, 0.1, 0.1]}\n"
        "  - {direction: [-0.3, -0.9, -0.4], rgb: [0.1, 1.5, 0.4]}\n"
    )
    return str(path)


def test_a_table_that_is_not_interpolated(tmp_path, device):
    name = small_sensor(tmp_path, (60, 80), 0.1, interpolation="floor")
    frames = [(0, np.eye(4), 1.0), (0, np.eye(4), 3.0)]
    difference = compare(name, [BALL], frames, device=device)
    # A slope at the border between two bins falls into either.
    assert difference.mean_grey <= 0.05


def test_delta_is_that_of_the_exact_solve(pair):
    sensor, gaps = pair
    description = sensor.description
    gaps = np.where(gaps < 4.0, gaps + np.float32(3.0), np.float32(np.inf))
    out = sensor.render(gaps, [1.0, 4.0])
    for k, force_n in enumerate((1.0, 4.0)):
        volume_mm3 = force_n * sensor.law.k_n_mm3_per_n.value
        delta_mm = solve_indentation(gaps[k], volume_mm3, description.pixel_area_mm2)
        assert out.indentation_mm[k] == pytest.approx(delta_mm - gaps[k].min(), abs=1e-6)
        assert out.depth_mm[k].sum(dtype=float) * description.pixel_area_mm2 == pytest.approx(
            volume_mm3, rel=1e-5
        )
        assert np.array_equal(out.contact_mask[k], out.depth_mm[k] > 0)


def test_nothing_and_everything(pair):
    sensor, gaps = pair
    gaps = gaps.copy()
    gaps[0] = np.inf
    out = sensor.render(gaps, [5.0, 1e6])
    rest = tacgen.Sensor("gelsight_mini").at_rest_rgb()
    assert np.array_equal(out.rgb[0], rest)
    assert out.indentation_mm[0] == 0
    assert not out.contact_mask[0].any()
    assert not out.saturated[0]
    assert out.saturated[1]
    assert out.indentation_mm[1] == pytest.approx(sensor.description.gel_depth_mm, abs=1e-6)
    assert np.array_equal(sensor.render(gaps, [0.0, 0.0]).rgb[1], rest)


def test_a_depth_that_is_given(pair):
    sensor, gaps = pair
    solved = sensor.render(gaps, [1.0, 3.0])
    kept = {name: np.array(getattr(solved, name)) for name in ("rgb", "depth_mm", "indentation_mm")}
    given = sensor.render_depth(kept["depth_mm"])
    assert np.array_equal(given.rgb, kept["rgb"])
    assert given.indentation_mm == pytest.approx(kept["indentation_mm"], abs=1e-6)
    assert not given.saturated.any()


def test_noise_is_the_same_from_run_to_run(pair, device):
    one, gaps = pair
    clean = one.render(gaps, 2.0).rgb.astype(int)
    runs = []
    for seed in (3, 3, 4):
        sensor = make_batch(noise=True, seed=seed, device=device)
        runs.append([sensor.render(gaps, 2.0).rgb.astype(int) for _ in range(2)])
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0][0], runs[0][1])
    assert not np.array_equal(runs[0][0], runs[2][0])
    noise = (runs[0][0] - clean)[(clean > 10) & (clean < 245)]
    # Rounding before and after adds a twelfth of a squared grey level each.
    expected = np.sqrt(sensor.table.noise_grey**2 + 1 / 6)
    assert noise.std() == pytest.approx(expected, rel=0.03)
    single = tacgen.Sensor("gelsight_mini", noise=True).render(BALL, np.eye(4), 2.0).rgb.astype(int)
    alike = (single - clean[0])[(clean[0] > 10) & (clean[0] < 245)]
    assert noise.mean() == pytest.approx(alike.mean(), abs=0.01)  # 4 standard errors


def test_a_law_of_depth_and_one_with_memory(pair, device):
    _, gaps = pair
    batch = partial(make_batch, device=device)
    assert batch(contact=LINEAR_DEPTH).render(gaps, [1.0, 4.0]).indentation_mm == pytest.approx(
        [0.1, 0.4], abs=1e-6
    )
    kept = batch(contact=replace(LINEAR_DEPTH, collision_margin_mm=0.15))
    assert kept.render(gaps, [1.0, 4.0]).indentation_mm == pytest.approx([0.0, 0.25], abs=1e-6)
    sensor = batch(contact=CREEP)
    area_mm2 = sensor.description.pixel_area_mm2
    times_s, force_n = [0.0, 0.5, 1.5], [1.0, 2.0]
    seen_mm3 = [
        sensor.render(gaps, force_n, time_s=t).depth_mm.sum(axis=(1, 2), dtype=float) * area_mm2
        for t in times_s
    ]
    for world in range(2):
        log = {"trial": 4 * [0.0], "time_s": [-1e-3, *times_s],
               "force_normal_n": [0.0, *3 * [force_n[world]]]}  # fmt: skip
        expected_mm3 = CREEP.predict(log, simulate=True)[0][1:]
        assert [row[world] for row in seen_mm3] == pytest.approx(expected_mm3, rel=1e-4)
    assert seen_mm3[2][0] > 1.1 * seen_mm3[0][0]
    sensor.reset([1])
    after_mm3 = sensor.render(gaps, force_n, time_s=1.6).depth_mm.sum(axis=(1, 2)) * area_mm2
    assert after_mm3[1] == pytest.approx(seen_mm3[0][1], rel=1e-3)
    assert after_mm3[0] > seen_mm3[2][0]


def test_arrays_come_out_as_they_went_in(pair):
    torch = pytest.importorskip("torch")
    import warp as wp

    sensor, gaps = pair
    rgb = sensor.render(gaps, [1.0, 2.0]).rgb.copy()
    out = sensor.render(torch.from_numpy(gaps), torch.tensor([1.0, 2.0]), torch.zeros(2, 2))
    assert isinstance(out.rgb, torch.Tensor)
    assert (out.rgb.dtype, out.contact_mask.dtype) == (torch.uint8, torch.bool)
    assert np.array_equal(out.rgb.numpy(), rgb)
    # The sensor's own memory, which its next call writes to.
    sensor.render(gaps, [0.0, 0.0])
    assert not np.array_equal(out.rgb.numpy(), rgb)
    assert isinstance(sensor.render(wp.array(gaps, device="cpu"), [1.0, 2.0]).rgb, wp.array)


def test_jax_arrays(pair):
    jax = pytest.importorskip("jax")
    sensor, gaps = pair
    rgb = sensor.render(gaps, [1.0, 2.0]).rgb.copy()
    out = sensor.render(jax.numpy.asarray(gaps), jax.numpy.asarray([1.0, 2.0]))
    assert isinstance(out.rgb, jax.Array)
    assert np.array_equal(np.asarray(out.rgb), rgb)


def with_nan(gaps):
    gaps = gaps.copy()
    gaps[1, 3, 4] = np.nan
    return gaps


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s, g: s.render(g[:1], [1.0, 1.0]), r"gap_mm has the shape \(1, 240, 320\); give"),
        (lambda s, g: s.render(g.astype(float), [1, 1]), "gap_mm is of float64; convert it to fl"),
        (
            lambda s, g: s.render(np.zeros(g.shape, np.int32), 1),
            "gap_mm is of int32; convert it to fl",
        ),
        (lambda s, g: s.render(g.astype(str), [1, 1]), "gap_mm is of <U32; convert it to numbers"),
        (lambda s, g: s.render("gaps", [1, 1]), "gap_mm is a str; give a torch, JAX, Warp or Num"),
        (lambda s, g: s.render(with_nan(g), [1, 1]), "world 1: the map holds NaN or an infi"),
        (lambda s, g: s.render(g, [1.0, -1.0]), "world 1: force_n is negative or not finite; give"),
        (lambda s, g: s.render(g, [np.nan, 1.0]), "world 0: force_n is negative or not finite"),
        (lambda s, g: s.render(g, [1.0]), r"force_n has the shape \(1,\); give \(2,\)"),
        (lambda s, g: s.render(g, ["a", "b"]), "force_n: could not convert string to float"),
        (
            lambda s, g: s.render(g, [1, 1], [[1, 0], [0, 0]]),
            "shear moves the object, which a gap map",
        ),
        (lambda s, g: s.render(g, [1, 1], [1, 0]), r"shear_n has the shape \(2,\); give \(2, 2\)"),
        (lambda s, g: s.render(np.where(g > 1, g, -np.inf).astype("f4"), 1), "world 0: the map h"),
        (
            lambda s, g: s.render_depth(with_nan(0 * np.isinf(g).astype("f4"))),
            "world 1: the map holds NaN",
        ),
        (lambda s, g: s.render_depth(g + np.float32(np.inf)), "world 0: the map holds NaN or an"),
        (lambda s, g: s.render_meshes([0, 2**40], two_poses(), [1, 1]), "world 1: mesh_ids has an"),
        (
            lambda s, g: s.render_meshes([0, 0], two_poses(), 1, time_s=[0, np.nan]),
            "time_s is not f",
        ),
        (
            lambda s, g: s.render_meshes([0, 0], two_poses(), 1, [[np.inf, 0]] * 2),
            "shear_n, turn or",
        ),
        (lambda s, g: s.reset([0.5]), "world_ids is of float64; give indices of worlds, or a mask"),
        (lambda s, g: s.reset([True]), "world_ids is of bool; give indices"),
        (lambda s, g: s.render_meshes([0, 9], two_poses(), [1, 1]), "world 1: mesh_ids has an ind"),
        (lambda s, g: s.render_meshes([0, 0], two_poses(2.0), [1, 1]), "world 1: the pose is no r"),
        (lambda s, g: s.render_meshes([0.5, 0], two_poses(), [1, 1]), "mesh_ids: .* are no int64"),
        (lambda s, g: s.reset([2]), "world_ids has 2; there are worlds 0 to 1"),
        (lambda s, g: s.add_mesh((9 * np.eye(3), np.zeros((0, 3), int))), "the mesh has no faces"),
    ],
)
@pytest.mark.parametrize("device", ["cpu"], indirect=True)
def test_input_that_cannot_be(pair, change, message):
    sensor, gaps = pair
    if not sensor._n_meshes:
        with pytest.raises(SensorError, match="there is no mesh yet; call add_mesh first"):
            sensor.render_meshes([0, 0], two_poses(), [1, 1])
        sensor.add_mesh(BALL)
    with pytest.raises((SensorError, ContactError), match=message):
        change(sensor, gaps)
    # The next call is as if nothing had been.
    assert sensor.render(gaps, [1.0, 1.0]).contact_mask.any()


def two_poses(scale=1.0):
    return np.stack([np.eye(4), np.diag([scale, scale, scale, 1.0])])


def test_an_array_of_another_device(pair):
    torch = pytest.importorskip("torch")
    sensor, gaps = pair
    with pytest.raises(SensorError, match="gap_mm cannot be read on cpu .*meta"):
        sensor.render(torch.zeros(gaps.shape, device="meta"), [1.0, 1.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n": 0}, "n = 0: give the number of worlds"),
        ({"n": 10**7}, r"\d+ worlds fit; give n = \d+"),
        ({"device": "tpu"}, r"device = 'tpu' is not here \(Warp sees cpu"),
        ({"markers": True}, "the sensor digit has no markers to draw"),
    ],
)
def test_batches_that_cannot_be(options, message):
    if options.get("device", "cpu") != "cpu":
        pytest.importorskip("warp")
    arguments = {"name": "digit", "n": 2, "device": "cpu"} | options
    with pytest.raises(SensorError, match=message):
        tacgen.BatchSensor(**arguments)


def test_a_table_of_another_sensor():
    with pytest.raises(TableError):
        make_batch(table=tacgen.Sensor("digit").description.table)


def test_other_effects_are_drawn_by_the_cpu_alone(tmp_path):
    name = small_sensor(tmp_path, (60, 80), 0.1, effects={"vignetting": {"strength": 0.2}})
    assert compare(name, [BALL], [(0, np.eye(4), 1.0)]).most_grey == 0
    pytest.importorskip("warp")
    with pytest.raises(TableError, match="no optical effect but shadows and skirts; .* vignetting"):
        make_batch(name=name, device="warp:cpu")


def test_warp_is_not_there(monkeypatch):
    monkeypatch.setattr("tacgen.core.errors.find_spec", lambda name: None)
    with pytest.raises(SensorError, match=r"warp, not installed .* `pip install 'tacgen\[batch"):
        make_batch(device="cuda")
    assert make_batch(1).render_depth(np.zeros((1, 240, 320), np.float32)).rgb.any()  # needs none


@pytest.mark.slow
def test_figures_of_batches():
    figures = {name: (value, unit) for name, value, unit, _ in batch_figures([2], "cpu", 5)}
    sizes = "320x240", "640x480"
    assert set(figures) == {
        f"batch_2_{way}_ms_{size}" for way in ("meshes", "gap") for size in sizes
    }
    assert all(value > 0 and unit == "ms" for value, unit in figures.values())
