"""The application, its groups of commands, and the arguments that commands share."""

import itertools
import json
import logging
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from tacgen.core.errors import did_you_mean, readable
from tacgen.core.processes import available_cores
from tacgen.core.progress import LOG, is_quiet
from tacgen.core.resources import object_folders, packaged, sensor_files

CALIBRATION = "Calibration and diagnosis"
DATASETS = "Datasets"
NETWORKS = "Networks"
CLUSTER = "Cluster"
MACHINE = "This machine"
ORDER_OF_WORK = (
    *("collect", "init", "grid", "render", "inspect", "view", "verify", "merge", "export"),
    *(
        "recipe",
        "objects",
    ),
    *("import", "calibrate", "read", "diagnose", "friction", "rig"),
    *("train", "eval", "predict", "study"),
    *("submit", "status"),
    *("doctor", "bench"),
)
"""Order of the commands in the help, and thereby of their panels."""
ANYWHERE = ("-v", "--verbose", "-q", "--quiet")
"""Options of ``tacgen`` that may also follow a command."""

_OUTPUT = {"json": False}  # whether a program reads the output of the command line that runs


class _InOrderOfWork(TyperGroup):
    def list_commands(self, ctx: Any) -> list[str]:
        names = super().list_commands(ctx)
        known = [name for name in ORDER_OF_WORK if name in names]
        return [*known, *(name for name in names if name not in known)]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Name the one command that resembles an unknown one."""
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            ctx.fail(f"No such command {args[0]!r}{did_you_mean(args[0], self.commands)}")
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Accept ``-v`` and ``-q`` after a command too, and ``help`` before one."""
        if args[:1] == ["help"]:
            args = [*args[1:], "--help"]
        end = args.index("--") if "--" in args else len(args)
        if "--out=" in args[:end] or ("--out", "") in itertools.pairwise(args[:end]):
            msg = "is empty (a variable that is not set?); give a folder or a file"
            raise typer.BadParameter(msg, param_hint="--out")
        if ctx.parent is None:
            _OUTPUT["json"] = "--json" in args[:end]
        anywhere = [arg for arg in args[:end] if ctx.parent is None and arg in ANYWHERE]
        rest = [arg for k, arg in enumerate(args) if k >= end or arg not in anywhere]
        return super().parse_args(ctx, [*anywhere, *rest])


def _print_version(wanted: bool) -> None:
    if wanted:
        from tacgen.core.resources import __version__

        typer.echo(__version__)
        raise typer.Exit


def _group(name: str, text: str, *, completion: bool = False) -> typer.Typer:
    return typer.Typer(
        name=name,
        help=text,
        cls=_InOrderOfWork,
        context_settings={"help_option_names": ["-h", "--help"]},
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        add_completion=completion,
    )


app = _group(
    "tacgen",
    "Simulated grasps with GelSight images, from a sensor calibrated on real presses.",
    completion=True,
)
calibrate_app = _group(
    "calibrate", "Fit the sensor model to ball presses: lookup table and contact law."
)
diagnose_app = _group(
    "diagnose", "Find the effects that explain the residuals of a calibrated model."
)
objects_app = _group("objects", "List and show the objects to grasp; add your own meshes.")
sensors_app = _group(
    "sensors", "List and show the sensors and where their colours come from; add your own."
)
recipe_app = _group("recipe", "Show a recipe with all of its settings; schemas for editors.")
app.add_typer(calibrate_app, rich_help_panel=CALIBRATION)
app.add_typer(diagnose_app, rich_help_panel=CALIBRATION)
app.add_typer(recipe_app, rich_help_panel=DATASETS)
app.add_typer(objects_app, rich_help_panel=DATASETS)
app.add_typer(sensors_app, rich_help_panel=CALIBRATION)


@app.callback()
def options(
    verbose: Annotated[
        bool,
        Option("-v", "--verbose", help="Print the traceback of an error; also after a command."),
    ] = False,
    quiet: Annotated[bool, Option("-q", "--quiet", help="No progress or notes.")] = False,
    version: Annotated[
        bool,
        Option("--version", callback=_print_version, is_eager=True, help="Print tacgen's version."),
    ] = False,
) -> None:
    """Accept the options before a command; ``-v`` and ``-q`` also stand after it."""
    LOG.setLevel(logging.DEBUG if verbose else logging.WARNING if quiet else logging.INFO)


def recipe_names() -> list[str]:
    """The shipped recipes, to complete arguments in a shell."""
    return sorted(path.stem for path in packaged("recipes").glob("*.yaml"))


def sensor_names() -> list[str]:
    """The sensors here, to complete arguments in a shell."""
    return list(sensor_files())


def object_names() -> list[str]:
    """The objects here, to complete arguments in a shell."""
    return list(object_folders())


RecipeArgument = Annotated[
    str,
    Argument(
        help="Path of a recipe (YAML), or the name of one that tacgen ships.",
        autocompletion=recipe_names,
    ),
]
DomeRadiusOption = Annotated[
    float | None,
    Option(help="Radius of the gel's dome, mm; default: the table's, flat where it states none."),
]
ForceFlag = Annotated[bool, Option("--force", help="Replace existing results.")]
DatasetArgument = Annotated[Path, Argument(help="Folder of a dataset that `tacgen collect` wrote.")]
PressesArgument = Annotated[
    Path,
    Argument(
        help="Folder of press images with presses.csv, or with --ball-radius-mm and --mm-per-px; "
        "or Taxim's dataPack.npz."
    ),
]
_REAL_GRASPS = "Folder of real grasps: grasps.csv and, optionally, images/."
RealGraspsArgument = Annotated[Path, Argument(help=_REAL_GRASPS)]
RealGraspsOption = Annotated[Path, Option(help=_REAL_GRASPS)]
ResultsOption = Annotated[
    Path, Option(help="Folder for the results; an interrupted run is resumed.")
]
MmPerPxOption = Annotated[
    float | None, Option(help="Pixel size on the gel, mm; needed if the presses do not state it.")
]
BallRadiusOption = Annotated[
    float | None, Option(help="Radius of the ball, mm; needed if the presses do not state it.")
]
MarkerPitchOption = Annotated[
    float | None, Option(help="Spacing of the markers whose summed motion the log holds, mm.")
]

ColumnOption = Annotated[
    list[str] | None,
    Option(
        metavar="NAME=HEADER",
        help='Header of a column in the log, such as force_normal_n="Fz [N]"; repeatable. A unit '
        "in brackets is converted.",
    ),
]
FlipOption = Annotated[
    list[str] | None,
    Option(metavar="NAME", help="Turn a column's sign: force, depth, volume or its full name."),
]
ForceUnitOption = Annotated[str | None, Option(help="If not newtons: n, mn, gf or kgf.")]
LogRadiusOption = Annotated[float | None, Option(help="Ball of presses with depths, mm.")]
MarkersOption = Annotated[
    Path | None,
    Option(
        help="Marker tracks of the presses: markers.csv, or a folder of press images with dots; "
        "needs --sensor."
    ),
]
MarkerSensorOption = Annotated[
    str | None, Option("--sensor", help="Of --markers or a bag: the sensor's name or YAML file.")
]
TopicOption = Annotated[
    list[str] | None,
    Option(help="Of a bag with several: the topic of pictures, that of the gauge; repeatable."),
]
BackgroundOption = Annotated[
    Path | None, Option(help="Picture of the gel at rest; else a recording's, or the table's own.")
]
LogTableOption = Annotated[Path | None, Option(help="table.npz, to read volumes in images.")]


def _workers(given: str) -> int:
    if given == "auto":
        return available_cores()
    if not given.isdecimal() or int(given) < 1:
        msg = f"{given!r} is not a number of processes; give 1 or more, or auto"
        raise typer.BadParameter(msg)
    return int(given)


AUTO: Any = "auto"
WorkersOption = Annotated[
    int, Option(parser=_workers, metavar="N", help="Parallel processes; auto: one for each core.")
]
JsonFlag = Annotated[bool, Option("--json", help="Print the result as JSON on standard output.")]


def print_result(record: object, text: str | Iterable[str], json_output: bool) -> None:
    """Print ``record`` as JSON, or otherwise ``text``, which may be an iterable of lines."""
    if json_output:
        typer.echo(json.dumps(record, indent=2, ensure_ascii=False))
    else:
        typer.echo(text if isinstance(text, str) else "\n".join(text))


def print_record(record: Mapping[str, object], json_output: bool) -> None:
    """Print a flat record as JSON, or as one line per entry."""

    def line(name: str, value: object) -> str:
        text = ", ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
        return f"{name.replace('_', ' '):>16}  {text}"

    print_result(record, [line(*entry) for entry in record.items()], json_output)


def warn(lines: Iterable[object], label: str = "warning") -> None:
    """Print lines on standard error."""
    for line in lines:
        typer.echo(f"{label}: {readable(str(line))}", err=True)


def note(lines: Iterable[object]) -> None:
    """Print notes on standard error, unless ``-q`` is given."""
    if not is_quiet():
        warn(lines, "note")


def quoted(word: object) -> str:
    """``word`` as it stands in a line to paste into a shell."""
    return shlex.quote(str(word))


def hand_over(*lines: str) -> None:
    """Print the next commands or lines of a recipe on standard error; not with -q or --json."""
    if not (is_quiet() or _OUTPUT["json"]):
        typer.echo("\n".join(["next:", *(f"  {line}" for line in lines)]), err=True)


IN_RECIPE = "in a recipe in this folder:"


def contact_lines(law: Path) -> list[str]:
    """Lines of a recipe that use a contact law."""
    return [IN_RECIPE, f"contact: {{file: {law}}}"]


def session_sensor(presses: Path) -> Path | None:
    """The sensor that a folder of presses describes in full, as a rig's does; None elsewhere."""
    from tacgen.core.errors import TacgenError
    from tacgen.core.files import is_file
    from tacgen.core.sensors import load_sensor

    path = presses / "sensor.yaml"
    if not is_file(path):
        return None
    try:
        load_sensor(str(path), needs_table=False)
    except TacgenError:  # it states the scale alone
        return None
    return path


def table_lines(
    path: Path,
    shape_px: tuple[int, int],
    mm_per_px: float,
    presses: Path | None = None,
    dome_radius_mm: float | None = None,
) -> list[str]:
    """Lines of a recipe that use a lookup table, with the sensor that its presses are of."""
    from tacgen.core.sensors import sensor_lines

    if presses is not None and (sensor := session_sensor(presses)) is not None:
        return [IN_RECIPE, f"sensor: {{name: {sensor}, table: {path}}}"]
    return sensor_lines(path, shape_px, mm_per_px, dome_radius_mm)
