"""The study of regrasping: every policy on the same episodes, and its page."""

from pathlib import Path

import numpy as np
import pytest

from tests.messages import refused

pytest.importorskip("torch")

from tacgen.collection.recipe import load_recipe
from tacgen.core.errors import LearningError
from tacgen.envs.regrasp import ObjectGrasps, Tried, regrasp
from tests.envs.regrasp_world import FEW, regrasp_world
from validation.regrasp.__main__ import main
from validation.regrasp.page import shown_episodes, write_study_page
from validation.regrasp.policies import POLICIES
from validation.regrasp.study import _network_scores, study

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def world() -> Path:
    return regrasp_world()


@pytest.fixture(scope="module")
def result(world):
    return study(world / "run", load_recipe(world / "small.yaml"), world / "study", FEW)


def test_every_policy_is_played_on_the_same_episodes(result):
    scores, played = result
    first = {key: listed for key, listed in played.episodes.items() if key[1] == 0}
    starts = {tuple((e.seed, e.steps[0].grasp) for e in listed) for listed in first.values()}
    assert len(starts) == 1
    assert {key[0] for key in first} == set(POLICIES)
    assert scores["policies"]["oracle"][2]["success"]["value"] >= max(
        scores["policies"][name][2]["success"]["value"] for name in POLICIES
    )


def test_every_episode_ends_in_a_lift_that_is_counted(result):
    scores, _ = result
    for by_regrasps in scores["policies"].values():
        for one in by_regrasps:
            failed = sum(one["drops"].values()) + one["not_executed"]
            assert one["success"]["value"] == pytest.approx(1 - failed / 3)


def test_by_touch_is_what_the_command_plays(result, world):
    """On the worlds that the study has simulated."""
    played = regrasp(world / "run", load_recipe(world / "small.yaml"), world / "study", FEW)
    of_study = result[0]["policies"]["touch"]
    assert [one["success"] for one in played["by_touch"]] == [
        one["success"]["value"] for one in of_study
    ]
    same = ("mean_regrasps", "drops", "not_executed")
    for mine, other in zip(played["by_touch"], of_study, strict=True):
        assert [mine[name] for name in same] == [other[name] for name in same]


def test_the_study_prints_a_line_a_policy(result, world, capsys, monkeypatch):
    words = [str(world / "run"), str(world / "small.yaml"), "--out", str(world / "study")]
    options = ["--episodes", "3", "--worlds", "3", "--regrasps", "2"]
    monkeypatch.setattr("sys.argv", ["validation.regrasp", *words, *options])
    main()
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(POLICIES)
    assert (world / "study" / "index.html").is_file()


def test_the_page_shows_three_episodes(result, tmp_path):
    scores, played = result
    write_study_page(tmp_path / "index.html", scores, played)
    page = (tmp_path / "index.html").read_text()
    shown = shown_episodes(played.episodes["touch", 2])
    assert page.count("<figure>") == sum(len(one.steps) for one in shown)
    assert "sugar_box" in page


def test_the_networks_accuracy_is_that_of_what_it_saw():
    """Two of three looks are right; grasps that show nothing would have made it 5 of 6."""
    seen = [(0.9, "held"), (0.2, "rotational_slip"), (0.7, "translational_slip")]
    unseen = [(0.0, status) for status in ("no_contact", "unreachable", "crashed")]
    other = tried([(0.1, "held")] * 6)
    scores = _network_scores({"can": ObjectGrasps((), tried(seen + unseen), other)})
    assert scores == {"accuracy": pytest.approx(2 / 3), "holds": pytest.approx(1 / 3)}
    with refused(LearningError):
        _network_scores({"can": ObjectGrasps((), tried(unseen), other)})


def tried(row: list[tuple[float, str]]) -> Tried:
    look, outcome = zip(*row, strict=True)
    return Tried((1,), np.array([look]), np.array([outcome]), np.zeros((1, len(row))))
