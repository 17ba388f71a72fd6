"""What the package carries: its files, and its version."""

import contextlib
import platform
import re
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tacgen.core.errors import ObjectError, RecipeError, TacgenError, did_you_mean
from tacgen.core.files import is_file, read_small_text

_PACKAGE = Path(__file__).parents[1]
_OF_RECIPES = re.compile(
    r"^\ufeff?\{?[\"']?(extends|objects|sensor|grid|training|indenters|rows|schedule)[\"']?\s*:",
    re.MULTILINE,
)
"""A key at the left edge that a recipe has, and no sensor, gripper or contact law."""
_MOST_BYTES = 10_000_000


def packaged(folder: str) -> Path:
    """The shipped ``recipes`` or ``objects`` folder, in the wheel or beside it in a checkout."""
    inside = _PACKAGE / "shipped" / folder
    return inside if inside.is_dir() else _PACKAGE.parent / folder


def find_recipe(name: str, *, extended_by: Path | None = None) -> Path:
    """The YAML file that ``name`` means: a path, a file in ``./recipes``, or a shipped recipe.

    The folder of a file that is ``extended_by`` another is searched first; ``extends: rig`` in
    ``rig.yaml`` is the shipped one.
    """
    beside = None if extended_by is None else extended_by.parent
    return _find_yaml(name, "recipes", "recipe", beside, but_not=extended_by)


def sensor_path(name: str, *, beside: Path | None = None) -> Path:
    """The YAML file of the sensor ``name``, found the same way in ``recipes/sensors``."""
    return _find_yaml(name, "recipes/sensors", "sensor", beside)


def sensor_files() -> dict[str, Path]:
    """The YAML file of every sensor by name: shipped ones, then those in ``./recipes/sensors``."""
    roots = [packaged("recipes") / "sensors", Path("recipes/sensors")]
    return {path.stem: path for root in roots for path in sorted(root.glob("*.yaml"))}


def gripper_path(name: str, *, beside: Path | None = None) -> Path:
    """The YAML file of the gripper ``name``, found the same way in ``recipes/grippers``."""
    return _find_yaml(name, "recipes/grippers", "gripper", beside)


def contact_law_path(name: str, *, beside: Path | None = None) -> Path:
    """The ``contact.yaml`` that a recipe names, found the same way."""
    return _find_yaml(name, "recipes", "contact law", beside)


def _find_yaml(
    name: str, folder: str, kind: str, beside: Path | None, but_not: Path | None = None
) -> Path:
    file = name if name.endswith((".yaml", ".yml")) else f"{name}.yaml"
    places = [Path(file), Path(folder) / file, packaged("recipes").parent / folder / file]
    if beside is not None:
        places.insert(0, beside / file)
    found = [place for place in places if is_file(place)]
    if kind == "recipe":
        wrong = [p for p in found if file != name and but_not and p.samefile(but_not)]
    else:  # a recipe that has its sensor's name is not that sensor
        wrong = [p for p in found if _is_recipe(p)]
    for place in found:
        if place not in wrong:
            return place
    shipped = sorted(path.stem for path in (packaged("recipes").parent / folder).glob("*.yaml"))
    fix = f"give the path of a YAML file or one of {', '.join(shipped)}"
    msg = f"no {kind} named {name!r}{did_you_mean(name, shipped)}; {fix}"
    if wrong:
        found_there = "the recipe itself" if kind == "recipe" else f"a recipe, not a {kind}"
        msg = f"{wrong[0]} is {found_there}: {msg}"
    raise RecipeError(msg)


def _is_recipe(path: Path) -> bool:
    try:
        return bool(_OF_RECIPES.search(read_small_text(path, _MOST_BYTES)))
    except (OSError, ValueError):  # as its reader will say
        return False


def object_folders(beside: Path | None = None) -> dict[str, Path]:
    """Every object by name: shipped ones, those in ``./objects`` and in ``beside/objects``.

    Of two with one name the later in this order is used.
    """
    roots = [packaged("objects"), Path("objects"), *([beside / "objects"] if beside else [])]
    files = [path for root in roots for path in sorted(root.glob("*/object.yaml"))]
    return {path.parent.name: path.parent for path in files if path.is_file()}


def find_object_folder(name: str, *, beside: Path | None = None) -> Path:
    """The folder of the object ``name``: a path, ``./objects/<name>``, or a shipped one.

    ``beside`` is the folder of the recipe that names it; it and its ``objects`` come first. Raises
    ``ObjectError`` if there is none.
    """
    for place in ([beside / name] if beside else []) + [Path(name)]:
        if is_file(place / "object.yaml"):
            return place
    folders = object_folders(beside)
    if name not in folders:
        msg = f"no object named {name!r}{unknown_object_hint(name, folders)}"
        raise ObjectError(msg)
    return folders[name]


def unknown_object_hint(name: str, known: Iterable[str]) -> str:
    """The end of a message about an object that is not known: similar name, known ones, fix."""
    known, fix = list(known), "add your own mesh with `tacgen objects add`"
    return f"{did_you_mean(name, known)}; known: {', '.join(known)}; {fix}"


try:
    __version__ = version("tacgen")
except PackageNotFoundError:  # a source tree on the path that was never installed
    __version__ = "0+not.installed"


def versions(*packages: str) -> dict[str, str]:
    """Versions of tacgen, of these packages and of Python, for the record of a result."""
    found = {name: version(name) for name in packages}
    return {"tacgen": __version__, **found, "python": platform.python_version()}


def newer_problem(found: object, known: int) -> str:
    """What is wrong with a file of schema ``found`` where ``known`` is read; or nothing."""
    if found == known:
        return ""
    if isinstance(found, int) and found > known:
        return f"made by a newer tacgen (schema {found}, this one reads {known}); upgrade tacgen"
    return f"of an unknown schema {found!r}; this tacgen reads {known}"


@contextlib.contextmanager
def newer_explains(where: object, made_by: object) -> Iterator[None]:
    """Say of a file ``where`` that a newer tacgen made it, if that is why it cannot be read.

    ``made_by`` is the version that the file states, if it states one.
    """
    try:
        yield
    except TacgenError as error:
        found, own = (_release(text) for text in (made_by, __version__))
        if not found or found <= own:
            raise
        text = f"made by a newer tacgen ({made_by}, this is {__version__}); upgrade tacgen"
        msg = f"{where}: {text}"
        raise type(error)(msg) from None


def _release(text: object) -> tuple[int, ...]:
    numbers = re.match(
        r"(\d{1,9})\.(\d{1,9})(?:\.(\d{1,9}))?", text if isinstance(text, str) else ""
    )
    return tuple(int(number or 0) for number in numbers.groups()) if numbers else ()
