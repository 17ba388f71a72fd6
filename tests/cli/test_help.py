"""The help: every command and option in plain words, in the order of the work."""

import click
import pytest
import typer
from typer.testing import CliRunner

import tacgen
from tacgen.cli import app
from tacgen.cli.common import ORDER_OF_WORK

ROOT = typer.main.get_command(app)


def commands(
    group: click.Group, path: tuple[str, ...] = ()
) -> dict[tuple[str, ...], click.Command]:
    found: dict[tuple[str, ...], click.Command] = {path: group}
    for name, command in group.commands.items():
        here = (*path, name)
        found |= commands(command, here) if hasattr(command, "commands") else {here: command}
    return found


COMMANDS = commands(ROOT)


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_command_answers_h_and_explains_each_of_its_options(path):
    run = CliRunner().invoke(app, [*path, "-h"], env={"COLUMNS": "200"})
    assert run.exit_code == 0
    assert "Usage:" in run.output
    assert "default: nan" not in run.output
    for parameter in COMMANDS[path].params:
        assert parameter.name == "help" or getattr(parameter, "help", ""), parameter.name


def test_the_help_begins_with_collecting_and_lists_commands_in_the_order_of_work():
    text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output
    panels = ("Datasets", "Calibration and diagnosis", "Networks", "Cluster", "This machine")
    places = [text.index(f"─ {panel} ") for panel in panels]
    assert places == sorted(places)
    assert text.index("│ collect") < text.index("│ grid") < text.index("│ calibrate")
    assert set(ORDER_OF_WORK) <= {path[0] for path in COMMANDS if path}


def test_the_version_is_an_option():
    run = CliRunner().invoke(app, ["--version"])
    assert (run.exit_code, run.output.strip()) == (0, tacgen.__version__)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "give the RUN to test"),
        (("--baseline", "oracle"), "Invalid value for '--baseline'"),
        (("run", "--baseline", "parameters"), "takes no RUN and no --real; give a dataset"),
    ],
)
def test_eval_says_what_it_needs(arguments, words):
    pytest.importorskip("torch")
    run = CliRunner().invoke(app, ["eval", *arguments])
    assert words in f"{run.output}{run.exception}"
