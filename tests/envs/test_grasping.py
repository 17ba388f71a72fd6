"""The environments: what Gymnasium and its learners ask, and the same bytes as a dataset."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import tacgen
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import LearningError, RecipeError
from tacgen.core.sensors import load_sensor
from tacgen.envs.grasp_world import grasp_values
from tests.envs.test_grasp_world import engine, small_recipe  # noqa: F401
from tests.messages import refused

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

from tacgen.envs import Normalized  # noqa: E402

GRASP, REGRASP = "tacgen/Grasp-v0", "tacgen/Regrasp-v0"
NOTHING_CHANGED = np.zeros(5)
BARE = {"scene_pictures": False}


def make(name, recipe=None, **options):
    return gymnasium.make(name, recipe=recipe or small_recipe(), **options).unwrapped


def lifting(*changes) -> np.ndarray:
    return np.array([1.0, *(changes or NOTHING_CHANGED)], np.float32)


def regrasping(*changes) -> np.ndarray:
    return np.array([-1.0, *(changes or NOTHING_CHANGED)], np.float32)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*Box:UserWarning")
@pytest.mark.parametrize(
    ("name", "frames"), [(GRASP, {"mode": "sequence", "count": 3}), (REGRASP, {})]
)
def test_gymnasium_has_nothing_against_them(name, frames):
    env = make(name, small_recipe(frames=frames), render_mode="rgb_array")
    check_env(env)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", [GRASP, REGRASP])
@pytest.mark.parametrize("frames", [{}, {"mode": "sequence", "count": 2}])
@pytest.mark.filterwarnings("error:.*:UserWarning")
def test_stable_baselines_takes_them_normalised_without_a_warning(name, frames):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = Normalized(gymnasium.make(name, recipe=small_recipe(frames=frames), image_px=(40, 48)))
    checker.check_env(env)
    assert env.observation_space["left_rgb"].shape == (40, 48, 6 if frames else 3)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("frames", [{}, {"mode": "sequence", "count": 3, "span_s": 3.0}])
def test_a_grasp_of_the_dataset_gives_the_images_of_its_shard(engine, frames, tmp_path):  # noqa: F811
    recipe = small_recipe(physics={"engine": engine}, frames=frames, grid={"sample": 2})
    tacgen.collect(recipe, tmp_path / "data", workers=1)
    dataset = tacgen.Dataset(tmp_path / "data")
    env = make(GRASP, recipe)
    for index in range(len(dataset)):
        kept = dataset[index]
        first, before = env.reset(seed=index, options={"grasp": index})
        assert "label" not in before
        obs, reward, terminated, truncated, info = env.step(first["gripper"][:5])
        shown = obs["left_rgb"] if frames else obs["left_rgb"][None]
        np.testing.assert_array_equal(shown, kept["rgb"])
        assert (info["label"], info["object"]) == (kept["label"], kept["object"])
        assert reward == float(kept["label"] == 1)
        assert (terminated, truncated) == (True, False)
    env.close()


def test_the_same_seed_gives_the_same_episodes_and_another_others():
    envs = [make(REGRASP, small_recipe(dataset=BARE)) for _ in range(2)]
    change = regrasping(2.0, 0.0, 4.0, -5.0, 0.0)
    runs = []
    for env, seeds in zip(envs, [(3, None), (3, None)], strict=True):
        run = []
        for seed in seeds:
            run += [env.reset(seed=seed)[0], env.step(change)[0], env.step(lifting())[1]]
        runs.append(run)
        env.close()
    for one, same in zip(*runs, strict=True):
        if isinstance(one, dict):
            assert all(np.array_equal(one[name], same[name]) for name in one)
        else:
            assert one == same
    assert not np.array_equal(runs[0][0]["left_rgb"], runs[0][3]["left_rgb"])


def test_regrasping_costs_and_ends_with_a_lift():
    env = make(REGRASP, max_regrasps=2, regrasp_cost=0.25)
    first, info = env.reset(seed=1, options={"object": "rubiks_cube"})
    assert (first["regrasps_left"], info["regrasps"], info["object"]) == (2, 0, "rubiks_cube")
    drawn, values = info["drawn"], first["gripper"][:5]
    for k in (1, 0):
        obs, reward, terminated, _, info = env.step(regrasping(0.5, 0.0, 1.0, 0.0, 0.0))
        assert (obs["regrasps_left"], reward, terminated) == (k, -0.25, False)
        expected = np.clip(values + np.array([0.5, 0.0, 1.0, 0.0, 0.0]), env.low, env.high)
        np.testing.assert_allclose(obs["gripper"][:5], expected, rtol=1e-6)
        values = obs["gripper"][:5]
        assert info["drawn"]["mass_kg"] == drawn["mass_kg"]
        assert tuple(info["drawn"]["center_of_mass_mm"]) == tuple(drawn["center_of_mass_mm"])
        assert tuple(info["drawn"]["gripper_off_mm"]) != tuple(drawn["gripper_off_mm"])
    assert "label" not in info
    obs, reward, terminated, _, info = env.step(regrasping())  # none are left
    assert terminated
    assert reward == float(info["label"] == 1)
    assert np.array_equal(obs["gripper"][:5], values)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(lifting())
    env.close()


def test_force_and_place_decide_what_the_reward_is():
    env = make(GRASP, small_recipe(randomize={}, dataset=BARE))
    env.reset(options={"object": "rubiks_cube"})
    *_, weak = env.step(np.array([1.0, 0.0, 0.0, 28.0, 0.0]))
    env.reset(options={"object": "rubiks_cube"})
    *_, firm = env.step(np.array([12.0, 0.0, 0.0, 28.0, 0.0]))
    assert (weak["label"], firm["label"]) == (0, 1)
    assert weak["margin_translational"] < 0 < firm["margin_translational"]
    assert weak["failure_mode"] == "translational_slip"
    env.close()


def test_a_grasp_that_cannot_be_executed_is_no_error():
    grid = {"force_n": [4.0], "y_mm": [0.0], "z_mm": [5.0, 30.0]}  # 5 mm: pads in the table
    recipe = small_recipe(grid=grid, randomize={}, dataset=BARE)
    env = make(GRASP, recipe)
    rest, _ = env.reset(seed=0)
    obs, reward, terminated, _, info = env.step(env.low.astype(np.float32))
    assert (reward, terminated, info["status"], info["label"]) == (0.0, True, "unreachable", -1)
    assert "into the table" in info["reason"]
    assert env.observation_space.contains(obs)
    assert obs["gripper"][5] == rest["gripper"][5]  # as open as before
    env.close()
    again = make(REGRASP, recipe)
    again.reset(seed=0)
    _, reward, _, _, info = again.step(regrasping(0.0, 0.0, 0.0, -25.0, 0.0))
    assert (reward, info["status"]) == (-0.1, "unreachable")
    assert again.step(lifting())[1:4] == (0.0, True, False)
    again.close()


def test_an_axis_that_the_recipe_fixes_has_a_hair_s_width():
    env = make(GRASP, small_recipe(grid={"force_n": 40.0, "x_mm": 3, "y_mm": 0, "z_mm": 20}))
    np.testing.assert_allclose(env.action_space.low, [39.6, 3.0, 0.0, 20.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(env.action_space.high, [40.0, 3.1, 0.1, 20.1, 0.001], rtol=1e-6)


def test_pictures_in_two_pads_and_their_size():
    env = make(
        GRASP,
        small_recipe(robot={"tactile_pads": "both"}, dataset=BARE),
        image_px=(60, 45),
        render_mode="rgb_array",
    )
    obs, _ = env.reset(seed=2)
    assert obs["left_rgb"].shape == obs["right_rgb"].shape == (60, 45, 3)
    before = env.render()
    env.step(np.array([8.0, 0.0, 0.0, 30.0, 0.0]))
    after = env.render()
    assert before.shape == after.shape == (640, 480 * 2 + 853, 3)
    assert not np.array_equal(before, after)
    env.close()


@pytest.mark.slow
def test_processes_side_by_side():
    options = {"recipe": small_recipe(dataset=BARE), "image_px": (40, 30)}
    vector = gymnasium.make_vec(
        REGRASP, num_envs=2, vectorization_mode="async", wrappers=[Normalized], **options
    )
    obs, _ = vector.reset(seed=7)
    assert obs["left_rgb"].shape == (2, 40, 30, 3)
    alone = Normalized(gymnasium.make(REGRASP, **options))
    expected, _ = alone.reset(seed=8)  # seeds count up from the first environment's
    np.testing.assert_array_equal(obs["left_rgb"][1], expected["left_rgb"])
    _, rewards, terminated, _, infos = vector.step(np.ones((2, 6), np.float32))
    assert terminated.all()
    assert set(infos["label"]) <= {0, 1}
    np.testing.assert_array_equal(rewards, infos["label"] == 1)
    processes = list(vector.processes)
    vector.close()
    alone.close()
    assert [process.exitcode for process in processes] == [0, 0]


@pytest.mark.parametrize(
    "action",
    [
        np.zeros(3),
        "firmly",
        np.array([4.0, 0.0, np.nan, 30.0, 0.0]),
        np.array([np.inf, 0.0, 0.0, 30.0, 0.0]),
        np.array([4.0, 0.0, 0.0, 41.0, 0.0]),
    ],
)
def test_what_is_no_action_is_refused(action):
    env = make(GRASP)
    env.reset(seed=0)
    with refused(LearningError):
        env.step(action)


@pytest.mark.filterwarnings("ignore:.*render_mode:UserWarning")
@pytest.mark.parametrize(
    ("name", "options"),
    [
        (GRASP, {"render_mode": "ansi"}),
        (GRASP, {"image_px": (0, 5)}),
        (GRASP, {"image_px": 64}),
        (REGRASP, {"max_regrasps": -1}),
        (REGRASP, {"regrasp_cost": float("nan")}),
        (REGRASP, {"regrasp_cost": "a"}),
    ],
)
def test_what_is_no_setting_is_refused(name, options):
    with refused(LearningError):
        make(name, **options)


def test_what_is_no_recipe_grasp_or_object_is_refused():
    with refused(RecipeError):
        gymnasium.make(GRASP, recipe="quikstart")
    env = make(GRASP)
    for options in (
        {"grasp": 36},
        {"grasp": "first"},
        {"shape": "cube"},
        {"grasp": 1, "object": "rubiks_cube"},
    ):
        with refused(LearningError):
            env.reset(options=options)
    with refused(RecipeError):
        env.reset(options={"object": "cube"})


def test_the_module_s_name_before_the_environment_s_registers_it(tmp_path):
    recipe = tmp_path / "own.yaml"
    recipe.write_text("name: own\nobjects: [golf_ball]\nsensor: digit\n", encoding="utf-8")
    code = (
        "import gymnasium; "
        f"env = gymnasium.make('tacgen.envs:tacgen/Grasp-v0', recipe={str(recipe)!r}); "
        "print(env.action_space.shape, env.unwrapped.world.objects)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "(5,) ('golf_ball',)\n"


@pytest.mark.parametrize("first", ["", "import tacgen; "])
def test_tacgen_s_name_registers_them_whichever_was_imported_first(first):
    code = (
        f"{first}import gymnasium; "
        "from gymnasium.envs.registration import _find_spec; "
        "names = [f'tacgen:tacgen/{name}-v0' for name in ('Grasp', 'Regrasp')]; "
        "print([_find_spec(name).max_episode_steps for name in names])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[2, 100]\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", [GRASP, REGRASP])
def test_a_copy_or_a_pickled_one_shows_the_same(name):
    more = {"max_regrasps": 5} if name == REGRASP else {}
    env = gymnasium.make(name, recipe=small_recipe(), image_px=(40, 48), **more)
    wanted, _ = env.reset(seed=3)
    ways = (copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one)))
    for way in ways:
        other = way(env.unwrapped)
        assert other.world is not env.unwrapped.world
        shown, _ = other.reset(seed=3)
        assert set(shown) == set(wanted)
        for key, values in wanted.items():
            np.testing.assert_array_equal(shown[key], values)
        other.close()
    env.close()


def test_frames_that_a_learner_would_take_for_rows_are_refused():
    recipe = small_recipe(frames={"mode": "sequence", "count": 24})
    env = gymnasium.make(GRASP, recipe=recipe, image_px=(48, 64))
    with refused(LearningError):
        Normalized(env)
    fits = Normalized(gymnasium.make(GRASP, recipe=recipe, image_px=(73, 80)))
    assert fits.observation_space["left_rgb"].shape == (73, 80, 72)


def test_without_gymnasium_it_says_what_to_install():
    code = (
        "import sys; sys.modules['gymnasium'] = None; import importlib.util as u; "
        "found = u.find_spec; "
        "u.find_spec = lambda n, *a: None if n == 'gymnasium' else found(n, *a); "
        "import tacgen.envs.grasp_world; from tacgen.envs import GraspEnv"
    )
    tried = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert "pip install 'tacgen[gym]'" in tried.stderr


def test_what_a_recipe_asks_for_is_in_the_observation():
    env = make(GRASP, small_recipe(frames={"mode": "sequence", "count": 4, "until": "lift"}))
    shapes = {name: space.shape for name, space in env.observation_space.items()}
    assert shapes == {
        "left_rgb": (4, 640, 480, 3),
        "left_markers_mm": (4, 48, 2),
        "left_force_field_n": (4, 3, 4, 3),
        "gripper": (6,),
    }
    env.reset(options={"grasp": 8})
    obs, *_ = env.step(grasp_values(env.world.plan[8]))
    pushed_n = obs["left_force_field_n"][-1, ..., 2].sum()
    assert 0.5 * 4 < pushed_n <= 4 * 1.03  # all of the normal force, or what is in the window
    assert 40 < obs["gripper"][5] < 75
    env.close()
    bare = make(GRASP, Recipe.model_validate({"name": "b", "objects": ["golf_ball"]}))
    assert set(bare.observation_space) == {"left_rgb", "gripper"}


@pytest.mark.parametrize("frames", ["grasp", "all"])
def test_cameras_show_the_object_before_the_grasp_and_the_gripper_after(frames):
    view = {"name": "left", "size_px": [36, 48]}  # of a stereo pair; the pad is another
    view |= {"look_at": {"from_mm": [300, -300, 250], "to_mm": [0, 0, 40]}}
    recipe = small_recipe(
        dataset=BARE,
        scene={"cameras": [view], "frames": frames},
        frames={"mode": "sequence", "count": 3, "until": "lift"},
    )
    env = make(GRASP, recipe)
    check_env(env, skip_render_check=True)
    before, _ = env.reset(options={"grasp": 4})
    assert before["left_rgb"].shape == (3, *load_sensor(recipe.sensor).shape_px, 3)
    assert before["camera_left_rgb"].shape == ((3,) if frames == "all" else ()) + (36, 48, 3)
    after, _, _, _, info = env.step(before["gripper"][:5])
    assert info["status"] == "executed"
    assert not any(np.shares_memory(before[name], after[name]) for name in before)
    last = (..., slice(None), slice(None))
    nearer = after["camera_left_depth_mm"][last] < before["camera_left_depth_mm"][last] - 5.0
    assert nearer.reshape(-1, 36, 48)[-1].sum() > 20  # the gripper, before the table and the object
    env.close()
