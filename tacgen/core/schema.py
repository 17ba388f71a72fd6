"""Records from YAML: read, checked, and written again."""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, TypeVar

import numpy as np
import yaml
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FiniteFloat,
    PrivateAttr,
    ValidationError,
)

from tacgen.core.errors import RecipeError, TacgenError, did_you_mean
from tacgen.core.resources import find_recipe

MAX_AXIS_VALUES = 10_000  # more is a misspelt axis


class Section(BaseModel):
    """A part of a YAML file: frozen, and no key that is not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


def as_named(given: Any) -> Any:
    """A section that is given by its name alone."""
    return {"name": given} if isinstance(given, str) else given


class Located(Section):
    """A section that names files; relative paths start at the folder of the YAML file."""

    path_key: ClassVar[str] = "file"
    """The key that holds the path."""

    _folder: Path | None = PrivateAttr(None)

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self.__dict__ == other.__dict__

    @property
    def folder(self) -> Path | None:
        """Folder of the YAML file that holds the section; None if no file does."""
        return self._folder


def set_folders(
    value: object, folder_of: Callable[[tuple[str | int, ...]], Path], key_path: Any = ()
) -> None:
    """Set the folder of every located section in ``value``, by its key path in the file."""
    if isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            set_folders(item, folder_of, (*key_path, i))
    elif isinstance(value, Section):
        if isinstance(value, Located):
            value._folder = folder_of((*key_path, value.path_key))
        for name in type(value).model_fields:
            set_folders(getattr(value, name), folder_of, (*key_path, name))


def _axis_values(given: Any) -> Any:
    """``4.0``, ``[1, 2]``, ``{linspace: [a, b, n]}`` and the like as a list."""
    if isinstance(given, (int, float)) and not isinstance(given, bool):
        return [given]
    if isinstance(given, (list, tuple)):
        return given
    kinds = ("linspace", "geomspace", "range")
    if not isinstance(given, dict) or len(given) != 1 or next(iter(given)) not in kinds:
        msg = (
            "must be a number, a list, {linspace: [start, stop, count]}, "
            "{geomspace: [start, stop, count]} or {range: [start, stop, step]}"
        )
        raise ValueError(msg)
    kind, arguments = next(iter(given.items()))
    is_triple = isinstance(arguments, list) and len(arguments) == 3
    if not (is_triple and all(isinstance(x, (int, float)) and math.isfinite(x) for x in arguments)):
        msg = f"{kind} takes three numbers, got {arguments!r}"
        raise ValueError(msg)
    start, stop, third = map(float, arguments)
    if kind == "geomspace" and min(start, stop) <= 0:
        msg = f"geomspace goes by equal factors between values above 0, got {arguments!r}"
        raise ValueError(msg)
    if kind == "range":
        if third == 0 or (stop - start) / third < 0:
            msg = f"range from {start:g} to {stop:g} cannot be divided into steps of {third:g}"
            raise ValueError(msg)
        # A small tolerance keeps the end value in, whatever 0.05 is in binary.
        count = int(np.floor((stop - start) / third + 1e-9)) + 1
        stop = start + (count - 1) * third
    elif (count := int(third)) < 1 or count != third:
        msg = f"{kind} takes a whole number of values, at least 1, got {arguments[2]!r}"
        raise ValueError(msg)
    if count > MAX_AXIS_VALUES:
        msg = f"has {count} values, more than {MAX_AXIS_VALUES}"
        raise ValueError(msg)
    spaced = np.geomspace if kind == "geomspace" else np.linspace
    return [round(float(value), 9) for value in spaced(start, stop, count)]


def _distinct(values: tuple[float, ...]) -> tuple[float, ...]:
    if not values:
        msg = "is empty; give at least one value"
        raise ValueError(msg)
    return tuple(dict.fromkeys(values))


Axis = Annotated[
    tuple[FiniteFloat, ...],
    BeforeValidator(
        _axis_values, json_schema_input_type=float | list[float] | dict[str, list[float]]
    ),
    AfterValidator(_distinct),
]


MAX_BYTES = 1 << 20  # no recipe has as much text
MAX_NODES = 200_000  # bounds on a file's size and on what its aliases may unfold to

MAX_NUMBER_LETTERS = 100  # Python takes minutes for the digits of a long number

_STANDARD_TAG = "tag:yaml.org,2002:"
_FLOWS = {"while parsing a flow sequence": "[", "while parsing a flow mapping": "{"}
"""What PyYAML was reading, and with which bracket that begins."""
_SCALARS = ("str", "int", "float", "bool", "null", "timestamp")
_SEXAGESIMAL = re.compile(r"[-+]?[0-9_]+(:[0-9_]+)+(\.[0-9_]*)?")  # 1:30 is 90 in YAML 1.1
_NO_TEXT = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")

KeyPath = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class YamlSource:
    """The content of a YAML file, and the file and line that each part of it came from."""

    path: Path
    data: dict[str, Any]
    origins: dict[KeyPath, tuple[Path, int]] = field(default_factory=dict)

    def origin(self, key_path: KeyPath) -> tuple[Path, int]:
        """File and line of ``key_path`` or the nearest key around it; line 0 if there is none."""
        keys = (key_path[:length] for length in range(len(key_path), 0, -1))
        return next((self.origins[key] for key in keys if key in self.origins), (self.path, 0))

    def problem(self, key_path: KeyPath, text: str) -> str:
        """One line: the file and line of ``key_path``, its dotted name, and ``text``."""
        file, line = self.origin(key_path)
        return f"{file}{f':{line}' if line else ''}: {dotted(key_path)} {text}"

    def repeated(self, key: str, names: Sequence[str], fix: str) -> Iterator[str]:
        """A problem for each entry of the list ``key`` whose name an earlier entry has."""
        for i, name in enumerate(names):
            if name in names[:i]:
                yield self.problem((key, i), f"= {name!r} is given twice; {fix}")


def dotted(key_path: KeyPath) -> str:
    """``("grid", "force_n", 2)`` as ``grid.force_n[2]``."""
    text = ""
    for key in key_path:
        text += f"[{key}]" if isinstance(key, int) else f".{key}" if text else str(key)
    return text


def read_yaml(path: Path) -> YamlSource:
    """Read one YAML mapping, merged over what it extends.

    Raises ``RecipeError`` if the file cannot be read, is not a mapping, repeats a key, or extends
    itself.
    """
    return _read(Path(path), ())


def _read(path: Path, extended_by: tuple[Path, ...]) -> YamlSource:
    own = _parse(path)
    if path.resolve() in extended_by:
        msg = f"{path}: extends itself; take it out of `extends:`"
        raise RecipeError(msg)
    bases = own.data.pop("extends", [])
    merged = YamlSource(path, {}, {})
    bases = [bases] if isinstance(bases, str) else bases
    if not isinstance(bases, list):
        msg = f"{path}: extends = {bases!r} is no name of a recipe and no list of names"
        raise RecipeError(msg)
    for name in bases:
        base = _read(find_recipe(str(name), extended_by=path), (*extended_by, path.resolve()))
        _merge(merged, base)
    _merge(merged, own)
    return merged


def _parse(path: Path) -> YamlSource:
    line, root = "", None
    try:
        if path.exists() and not path.is_file():
            problem = "not a file; give a YAML file"
        elif path.stat().st_size > MAX_BYTES:
            problem = f"larger than {MAX_BYTES >> 20} MiB; this is not a recipe"
        else:
            root = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
            problem = "holds no `key: value` pairs"
    except FileNotFoundError:
        problem = "no such file"
    except (OSError, UnicodeDecodeError) as error:
        problem = f"cannot be read: {error}"
    except RecursionError:
        problem = "nested too deeply; this is not a recipe"
    except yaml.YAMLError as error:
        # A bracket that is not closed is found lines later: what it opens says where it is.
        bracket = _FLOWS.get(getattr(error, "context", None) or "")
        mark = getattr(error, "context_mark" if bracket else "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        found = f"; close the `{bracket}` of this line" if bracket else ""
        problem = f"not valid YAML: {getattr(error, 'problem', None) or error}{found}"
    except (ValueError, OverflowError):
        problem = "not valid YAML: it asks for a character that there is not"
    if not isinstance(root, yaml.MappingNode):
        msg = f"{path}{line}: {problem}"
        raise RecipeError(msg)
    source = YamlSource(path, {}, {})
    source.data.update(_NodeReader(source).read(root, ()))
    return source


class _NodeReader:
    """Plain data of nodes; notes lines, refuses custom tags, repeated keys and too many nodes."""

    def __init__(self, source: YamlSource) -> None:
        self._source = source
        self._constructor = yaml.SafeLoader("")
        self._nodes = 0

    def read(self, node: yaml.Node, key_path: KeyPath) -> Any:
        self._nodes += 1
        if self._nodes > MAX_NODES or len(key_path) > 50:
            msg = f"{self._source.path}: unfolds to too many parts; write it without aliases"
            raise RecipeError(msg)
        self._source.origins.setdefault(key_path, (self._source.path, node.start_mark.line + 1))
        kinds: tuple[str, ...] = _SCALARS
        if isinstance(node, yaml.CollectionNode):
            kinds = ("seq",) if isinstance(node, yaml.SequenceNode) else ("map",)
        if node.tag.removeprefix(_STANDARD_TAG) not in kinds:
            self._refuse(key_path, f"has the tag {node.tag}; remove it")
        if isinstance(node, yaml.SequenceNode):
            return [self.read(item, (*key_path, i)) for i, item in enumerate(node.value)]
        if isinstance(node, yaml.MappingNode):
            result: dict[str, Any] = {}
            for key_node, value_node in node.value:
                if not isinstance(key_node, yaml.ScalarNode):
                    self._refuse(key_path, "has a list or a mapping as a key; write a name")
                key = str(key_node.value)
                here = (*key_path, key)
                self._check_text(here, key)
                self._source.origins[here] = (self._source.path, key_node.start_mark.line + 1)
                if key in result:
                    self._refuse(here, "is given twice; keep one")
                result[key] = self.read(value_node, here)
            return result
        return self._scalar(node, key_path)

    def _scalar(self, node: yaml.Node, key_path: KeyPath) -> Any:
        self._check_text(key_path, node.value)
        if not node.tag.endswith((":str", ":timestamp")):
            if len(node.value) > MAX_NUMBER_LETTERS:
                self._refuse(key_path, f"has {len(node.value)} letters, which is no number")
            if _SEXAGESIMAL.fullmatch(node.value):
                fix = "write the number, or put it in quotes"
                self._refuse(key_path, f"= {node.value} counts in sixties in YAML; {fix}")
        try:
            return self._constructor.construct_object(node)
        except (yaml.YAMLError, ValueError, LookupError, AttributeError, TypeError) as error:
            kind = node.tag.removeprefix(_STANDARD_TAG)
            why = error if isinstance(error, (yaml.YAMLError, ValueError)) else "it is none"
            return self._refuse(key_path, f"= {node.value[:40]!r} cannot be read as {kind}: {why}")

    def _check_text(self, key_path: KeyPath, text: str) -> None:
        if found := _NO_TEXT.search(text):
            what = f"U+{ord(found[0]):04X}, which is no character of a text; delete it"
            self._refuse(tuple(_NO_TEXT.sub("?", str(key)) for key in key_path), f"holds {what}")

    def _refuse(self, key_path: KeyPath, text: str) -> NoReturn:
        raise RecipeError(self._source.problem(key_path, text)) from None


def _merge(below: YamlSource, above: YamlSource) -> None:
    """Lay ``above`` over ``below``: mappings merge key by key, anything else replaces."""

    def lay(target: dict[str, Any], data: Mapping[str, Any], key_path: KeyPath) -> None:
        for key, value in data.items():
            here = (*key_path, key)
            if isinstance(value, dict) and isinstance(target.get(key), dict):
                lay(target[key], value, here)
                continue
            target[key] = value
            replaced.add(here)

    def is_replaced(path: KeyPath) -> bool:
        return any(path[: n + 1] in replaced for n in range(len(path)))

    replaced: set[KeyPath] = set()
    lay(below.data, above.data, ())
    for path in list(filter(is_replaced, below.origins)):
        del below.origins[path]
    below.origins.update({p: at for p, at in above.origins.items() if is_replaced(p)})


MOST_PROBLEMS = 50  # that one message describes


def validate(
    model: type[Model], source: YamlSource, error_type: type[TacgenError] = RecipeError
) -> Model:
    """``source`` as a ``model``; one error lists every problem.

    Relative paths in its sections start at the folder of the file that gives them.
    """
    if kind := _other_kind(source.data, model):
        msg = f"{source.path}: this is {FILE_KINDS[kind][0]}; give another file"
        raise error_type(msg)
    try:
        checked = model.model_validate(source.data)
    except ValidationError as error:
        found = error.errors()
        problems = [_describe(source, model, details) for details in found[:MOST_PROBLEMS]]
        if len(found) > MOST_PROBLEMS:
            problems.append(f"{source.path}: {len(found) - MOST_PROBLEMS} further problems")
        raise error_type.from_problems(problems) from None
    set_folders(checked, lambda key_path: source.origin(key_path)[0].parent)
    return checked


def load_checked(
    model: type[Model], name: str | Path, *checks: Callable[[Model, YamlSource], Iterable[str]]
) -> Model:
    """The recipe ``name``: a path, or the name of a shipped one.

    Raises ``RecipeError`` with all problems of its values, or else those that ``checks`` find.
    """
    source = read_yaml(find_recipe(str(name)))
    checked = validate(model, source)
    problems = [text for check in checks for text in check(checked, source)]
    RecipeError.raise_if(problems)
    return checked


FILE_KINDS: Mapping[str, tuple[str, set[str]]] = {
    "Recipe": (
        "a recipe for `tacgen collect`",
        {"grid", "robot", "physics", "frames", "randomize", "dataset", "contact"},
    ),
    "TrainRecipe": (
        "a training recipe, for `tacgen train`",
        {"model", "input", "training", "augmentation", "per_object"},
    ),
    "RigRecipe": (
        "a rig recipe, for `tacgen rig`",
        {"indenters", "schedule", "temperature", "images", "output"},
    ),
    "Study": ("a study, for `tacgen study`", {"rows", "quick", "data", "train"}),
    "_SensorYaml": (
        "a sensor, which a recipe names as `sensor: PATH`",
        {"height_px", "width_px", "gel_depth_mm", "leds"},
    ),
    "ObjectDescription": (
        "an object, whose folder a recipe names under `objects:`",
        {"shape", "mass_kg", "center_of_mass_mm", "grasp_ranges"},
    ),
    "contact law": (
        "a contact law, which a recipe names as `contact: {file: PATH}`",
        {"k_n_mm3_per_n", "k_s_mm_per_n", "marker_pitch_mm", "provenance"},
    ),
}
"""Purpose of each kind of file, and keys that no other kind has, by the name of its model."""


def kind_of(data: Mapping[str, Any]) -> str:
    """The kind of file (a key of ``FILE_KINDS``) whose keys ``data`` has; empty if none."""
    counts = {name: len(keys & data.keys()) for name, (_, keys) in FILE_KINDS.items()}
    best = max(counts, key=lambda name: counts[name])
    return best if counts[best] else ""


def _other_kind(data: Mapping[str, Any], model: type[BaseModel]) -> str:
    """The kind of a file that is not one for ``model``; empty if it may be one."""
    kind = kind_of(data)
    own = FILE_KINDS[model.__name__][1] if model.__name__ in FILE_KINDS else data.keys()
    return "" if own & data.keys() or kind == model.__name__ else kind


def _describe(source: YamlSource, model: type[BaseModel], details: Any) -> str:
    key_path = _written_path(source.data, details["loc"])
    kind, given = details["type"], details.get("input")
    if kind in UNKNOWN_KEY:
        return source.problem(key_path, unknown_key_text(model, key_path))
    if kind == "missing":
        written = [key for key in details["loc"] if "[" not in str(key)]  # no tag of a union
        return source.problem(tuple(written), "is missing; add it")
    if kind in ("model_type", "dataclass_type"):
        return source.problem(key_path, f"= {given!r} must hold `key: value` pairs")
    text = problem_text(details)
    if isinstance(given, (str, int, float)):
        return source.problem(key_path, f"= {given!r}: {text}")
    return source.problem(key_path, text if key_path else f": {text}")


UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")


def unknown_key_text(model: type[BaseModel], key_path: KeyPath) -> str:
    """That the last key of the path is not known, which one may be meant and which there are."""
    parent, key = _field_names(model, key_path[:-1]), str(key_path[-1])
    near = did_you_mean(key, parent) or _meant(key, parent, model)
    known = f"; known here: {', '.join(parent)}" if parent else ""
    return f"is not a known key{near}{known}"


def _meant(key: str, parent: Sequence[str], model: type[BaseModel]) -> str:
    """`` (did you mean 'x'?)`` with a key beside it, or of another section, of which it is a part;
    empty if there is none.
    """
    names = {name: name for name in parent}
    sections = {name: _field_names(model, (name,)) for name in _field_names(model, ())}
    # Of two sections with such a key the smaller one is about it.
    by_size = sorted(sections.items(), key=lambda section: len(section[1]))
    names |= {f"{above}.{name}": name for above, inner in by_size for name in inner}
    near = (name for name, last in names.items() if last == key or last.endswith(f"_{key}"))
    return next((f" (did you mean {name!r}?)" for name in near), "")


_WORDS = {
    "greater_than": "must be above {gt}",
    "greater_than_equal": "must be at least {ge}",
    "less_than": "must be below {lt}",
    "less_than_equal": "must be at most {le}",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have at most {max_length} entries",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "must match the pattern {pattern}",
    "int_from_float": "must be a whole number",
}
_TYPE_WORDS = {
    "float": "must be a number",
    "int": "must be a whole number",
    "bool": "must be true or false",
    "string": "must be text",
    "tuple": "must be a list",
    "list": "must be a list",
    "dict": "must hold `key: value` pairs",
    "mapping": "must hold `key: value` pairs",
}


def problem_text(details: Any) -> str:
    """One of pydantic's error records in plain words, such as ``must be above 0``."""
    kind = str(details["type"])
    if kind in _WORDS:
        return _WORDS[kind].format(**details.get("ctx", {}))
    if kind.endswith(("_type", "_parsing")) and kind.partition("_")[0] in _TYPE_WORDS:
        return _TYPE_WORDS[kind.partition("_")[0]]
    return str(details["msg"]).removeprefix("Value error, ")


def _written_path(data: Any, location: tuple[str | int, ...]) -> KeyPath:
    """The part of pydantic's location that exists in the file (union tags are not written)."""
    path: list[str | int] = []
    for key in location:
        if isinstance(data, dict) and key in data:
            data = data[key]
        elif isinstance(data, list) and isinstance(key, int) and key < len(data):
            data = data[key]
        else:
            continue
        path.append(key)
    return tuple(path)


@cache
def _schema(model: type[BaseModel]) -> dict[str, Any]:
    return model.model_json_schema()


def _field_names(model: type[BaseModel], key_path: KeyPath) -> list[str]:
    """The keys a model knows at ``key_path``; empty if they are not known."""
    part = schema = _schema(model)
    for key in key_path:
        if isinstance(key, str):
            written = json.dumps(part.get("properties", {}).get(key))
            reference = re.search(r'"#/\$defs/(.+?)"', written)
            part = schema["$defs"][reference[1]] if reference else {}
    return sorted(part.get("properties", {}))
