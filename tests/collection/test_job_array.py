"""Shares of batch jobs: together they are everything, and no shard is in two."""

import pytest

from tacgen.collection.job_array import parse_share
from tacgen.core.errors import DatasetError
from tests.messages import refused


def test_a_share_is_given_by_hand():
    assert parse_share("3/8", {})[:2] == (3, 8)


@pytest.mark.parametrize("text", ["8/8", "1", "a/b", "-1/4", "1/0", "/", "1.5/4"])
def test_a_share_that_is_none_is_refused(text):
    with refused(DatasetError):
        parse_share(text, {})


def slurm(task, first, last, step=1):
    return {
        "SLURM_ARRAY_TASK_ID": str(task),
        "SLURM_ARRAY_TASK_MIN": str(first),
        "SLURM_ARRAY_TASK_MAX": str(last),
        "SLURM_ARRAY_TASK_STEP": str(step),
        "SLURM_ARRAY_TASK_COUNT": str((last - first) // step + 1),
    }


@pytest.mark.parametrize(("first", "last", "step"), [(0, 9, 1), (1, 10, 1), (2, 20, 3)])
def test_a_slurm_arrays_tasks_take_every_part_once(first, last, step):
    tasks = range(first, last + 1, step)
    places = [parse_share("auto", slurm(task, first, last, step)) for task in tasks]
    assert [part for part, _, _ in places] == list(range(len(tasks)))
    assert {parts for _, parts, _ in places} == {len(tasks)}
    assert places[0][2] == "SLURM_ARRAY_TASK_ID"


def test_a_slurm_array_with_gaps_is_refused_rather_than_guessed():
    gaps = slurm(7, 3, 7) | {"SLURM_ARRAY_TASK_COUNT": "2"}
    with refused(DatasetError):
        parse_share("auto", gaps)


def test_a_kubernetes_indexed_job_needs_its_completions():
    with refused(DatasetError):
        parse_share("auto", {"JOB_COMPLETION_INDEX": "3"})
    environment = {"JOB_COMPLETION_INDEX": "3", "JOB_COMPLETIONS": "5"}
    assert parse_share("auto", environment) == (3, 5, "JOB_COMPLETION_INDEX")


def test_auto_outside_a_job_says_what_to_give():
    with refused(DatasetError):
        parse_share("auto", {})


@pytest.mark.parametrize(
    "environment",
    [
        {"SLURM_ARRAY_TASK_ID": "x"},
        {"SLURM_ARRAY_TASK_ID": "1"},
        slurm(1, 2, 5),
        {"JOB_COMPLETION_INDEX": "4", "JOB_COMPLETIONS": "4"},
        {"JOB_COMPLETION_INDEX": "1", "JOB_COMPLETIONS": ""},
    ],
)
def test_a_place_that_cannot_be_is_refused_and_never_taken_for_another(environment):
    with refused(DatasetError):
        parse_share("auto", environment)
