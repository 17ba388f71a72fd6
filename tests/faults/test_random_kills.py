"""Every command ended at random moments; the hundred of them are in ``validation/processes``."""

from pathlib import Path

import pytest

from validation.processes.random_kills import COMMANDS, prepare, trials


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_ended_at_any_moment_ends_and_goes_on(name: str, tmp_path: Path) -> None:
    prepare(tmp_path)
    for trial in trials(tmp_path, 8, (name,), seed=1):  # the first at half of its time
        assert not trial.problems
        if trial.was_amid:
            return
    pytest.fail("each of the runs had ended before its signal")
