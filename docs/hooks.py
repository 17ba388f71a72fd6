"""MkDocs hooks: tables of keys, columns and commands from the code itself; formulas as pictures."""

from __future__ import annotations

import base64
import inspect
import io
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import typer
import yaml
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import math_to_image
from pydantic import BaseModel

from tacgen.cli.common import app
from tacgen.cli.recipes import recipe_kinds
from tacgen.contact.effects import all_effects
from tacgen.core import records
from tacgen.core.resources import packaged
from tacgen.core.schema import kind_of, read_yaml
from tacgen.core.sensors import _SensorYaml
from tacgen.diagnose.rules import ContactRules, SearchRules
from tacgen.objects.description import ObjectDescription

UNITS = {
    "mm3_per_n": "mm³/N",
    "mm_per_n": "mm/N",
    "mm_per_px": "mm/px",
    "n_s_mm": "N·s/mm",
    "n_mm": "N/mm",
    "mm_s2": "mm/s²",
    "mm_s": "mm/s",
    "mm3": "mm³",
    "mm": "mm",
    "rad": "rad",
    "kg": "kg",
    "hz": "Hz",
    "px": "px",
    "min": "min",
    "gb": "GB",
    "mb": "MB",
    "grey": "grey levels",
    "c": "°C",
    "s": "s",
    "n": "N",
}
"""Unit by the end of a key, longer ends first."""
EXAMPLES = {
    "objects.friction": "0.45",
    "objects.mass_kg": "0.3",
    "objects.spinning_friction_mm": "1.2",
    "spinning_friction_mm.value": "1.2",
    "grid.x_mm": "[0, 5]",
    "grid.file": "grasps.csv",
    "grid.sample": "150",
    "sensor.table": "table.npz",
    "sensor.dome_radius_mm": "30",
    "sensor.mm_per_px": "0.0634",
    "contact.file": "contact.yaml",
    "cluster.partition": "gpu",
    "cluster.account": "my_group",
    "cluster.qos": "normal",
    "cluster.constraint": "avx2",
    "cluster.max_array": "1000",
    "cluster.setup": "[module load python]",
    "cluster.sbatch": "{gpus: 1}",
    "dataset.force_field": "[9, 12]",
    "scene.cameras.name": "front",
    "scene.cameras.look_at.from_mm": "[350, -420, 300]",
    "scene.cameras.look_at.to_mm": "[0, 0, 90]",
    "input.pad": "left",
    "input.frames": "8",
    "training.grasps": "100",
    "grid.force_n": "{geomspace: [2, 20, 7]}",
    "grid.y_mm": "[-8, 0, 8]",
    "grid.z_mm": "{range: [40, 80, 10]}",
    "objects.grid.x_mm": "[0, 5]",
    "objects.grid.yaw_rad": "[0, 0.785]",
    "grid.yaw_rad": "[0, 0.785]",
    "shape.mesh": "surface.ply",
    "shape.collision": "collision.npz",
    "shape.source": "part.stl",
    "friction.source": "fitted by `tacgen friction`",
    "spinning_friction_mm.source": "measured",
    "grasp_ranges.source": "around mg/(2μ)",
}
"""Examples of keys whose default is empty and that no shipped recipe sets."""
KINDS: dict[str, type[BaseModel]] = {name: model for name, (model, _) in recipe_kinds().items()}
KINDS |= {"sensor": _SensorYaml, "object": ObjectDescription}
_FOLDERS = {"sensor": ("recipes", "sensors/*.yaml"), "object": ("objects", "*/object.yaml")}


@dataclass(frozen=True)
class Key:
    """A row of the reference: a key with its dotted path, e.g. ``grid.force_n``."""

    path: str
    type: str
    unit: str
    default: str
    meaning: str
    example: str


def keys_of(kind: str) -> list[Key]:
    """Every key of a kind of file, sections before their own keys."""
    schema = KINDS[kind].model_json_schema()
    return list(_keys(schema, schema.get("$defs", {}), "", list(_shipped(kind))))


FORMULA = re.compile(
    r"```.*?```|`[^`\n]*`|^    [^\n]*|"
    r"\$\$(?P<display>.+?)\$\$|\$(?P<inline>[^$]+)\$|\b(?P<symbol>[kF]_[ns])\b",
    re.S | re.M,
)
"""Code, which stays as it is, a formula in TeX, or a symbol such as k_n."""


TEX = {
    r"\\(mathbf|mathbb|tilde|hat|bar|mathrm|sqrt) ?([A-Za-z])(?![A-Za-z])": r"\\\1{\2}",
    r"\\[td]frac ?(\d)(\d)": r"\\frac{\1}{\2}",
    r"\\[td]frac": r"\\frac",
    r"\\[bB]ig[lrg]*": "",
    r"\\(lVert|rVert)": r"\\Vert",
}
"""TeX that matplotlib does not know, and what it knows instead."""


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Replace formulas and the comments that stand for tables.

    They are ``<!-- keys: KIND -->``, ``<!-- columns: LIST -->``, ``<!-- commands -->``,
    ``<!-- effects -->`` and ``<!-- rules -->``.
    """
    markdown = FORMULA.sub(_formula, markdown)
    markdown = re.sub(r"<!-- keys: (\w+) -->", lambda found: _tables(found[1]), markdown)
    markdown = re.sub("<!-- commands -->", lambda _: "\n\n".join(_commands()), markdown)
    markdown = re.sub("<!-- effects -->", lambda _: _effects(), markdown)
    markdown = re.sub("<!-- rules -->", lambda _: _rules(), markdown)
    return re.sub(r"<!-- columns: (\w+) -->", lambda found: _columns(found[1]), markdown)


def _formula(found: re.Match[str]) -> str:
    """A formula as a picture, which browsers show without a script or network."""
    if found["symbol"]:
        return "{}<sub>{}</sub>".format(*found["symbol"].split("_"))
    tex = found["display"] or found["inline"]
    if tex is None:
        return found[0]
    tex = " ".join(tex.split())
    for other, known in TEX.items():
        tex = re.sub(other, known, tex)
    buffer = io.BytesIO()
    with mpl.rc_context({"mathtext.fontset": "stix", "svg.hashsalt": tex}):
        depth = math_to_image(f"${tex}$", buffer, FontProperties(size=12), dpi=72, format="svg")
    svg = buffer.getvalue()
    height = float(re.search(rb'height="([\d.]+)pt"', svg)[1])  # type: ignore[index]
    code = base64.b64encode(svg).decode()
    kind = "shown" if found["display"] else "within"
    text = tex.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    style = f"height:{height / 11:.2f}em;vertical-align:-{depth / 11:.2f}em"  # as large as text
    return (
        f'<img class="formula-{kind}" alt="{text}" style="{style}" '
        f'src="data:image/svg+xml;base64,{code}">'
    )


def _effects() -> str:
    """The effects that a contact law may have, by channel."""
    rows = [f"| `{one.name}` | {one.channel} | {one.about} |" for one in all_effects()]
    return "\n".join(["| effect | channel | meaning |", "|---|---|---|", *rows])


def _rules() -> str:
    """The thresholds of the contact diagnosis, each with the reason that stands beside it."""
    source = inspect.getsource(ContactRules) + inspect.getsource(SearchRules)
    lines = re.findall(r"^    (\w+): .* = (.*)  # (.+)$", source, re.M)
    rows = [f"| `{name}` | {value} | {reason} |" for name, value, reason in lines]
    return "\n".join(["| rule | value | reason |", "|---|---|---|", *rows])


def _commands() -> Iterator[str]:
    """Every command with its arguments and options, in the order of ``tacgen --help``."""

    def walk(command: Any, name: str) -> Iterator[str]:
        if hasattr(command, "commands"):
            for part in command.list_commands(typer.Context(command)):
                yield from walk(command.commands[part], f"{name} {part}")
            return
        rows = [
            f"| {_parameter(one)} | {_default(one)} | {' '.join((one.help or '').split())} |"
            for one in command.params
            if one.name != "help"
        ]
        help_text = "\n\n".join(part.strip() for part in (command.help or "").split("\n\n"))
        table = ["| argument or option | default | meaning |", "|---|---|---|", *rows]
        yield "\n".join([f"## `{name}`", "", help_text, "", *(table if rows else ())])

    yield from walk(typer.main.get_command(app), "tacgen")


def _parameter(one: Any) -> str:
    if one.param_type_name == "argument":
        return f"`{(one.metavar or one.name).strip('{}')}`"
    return ", ".join(f"`{name}`" for name in (*one.opts, *one.secondary_opts))


def _default(one: Any) -> str:
    if one.required:
        return "required"
    return "" if one.default in (None, False, "") or callable(one.default) else f"`{one.default}`"


def _columns(name: str) -> str:
    rows = [f"| `{column}` | {text} |" for column, text in getattr(records, name).items()]
    return "\n".join(["| column | meaning |", "|---|---|", *rows])


def _tables(kind: str) -> str:
    sections: dict[str, list[Key]] = {}
    for key in keys_of(kind):
        sections.setdefault(key.path.rpartition(".")[0], []).append(key)
    head = "| key | type | unit | default | meaning | example |\n|---|---|---|---|---|---|"
    parts = []
    for section, keys in sections.items():
        title = f"### {kind}: `{section}`\n\n" if section else ""
        rows = "\n".join(
            "| `{}` | {} | {} | {} | {} | {} |".format(
                key.path.rpartition(".")[2],
                key.type,
                key.unit,
                key.default if key.default in ("", "required") else f"`{key.default}`",
                key.meaning,
                f"`{key.example}`" if key.example else "",
            )
            for key in keys
        )
        parts.append(f"{title}{head}\n{rows}")
    return "\n\n".join(parts)


def _keys(
    section: Mapping[str, Any], defs: Mapping[str, Any], path: str, files: list[Any]
) -> Iterator[Key]:
    required = section.get("required", ())
    nested = []
    for name, schema in section["properties"].items():
        here = f"{path}.{name}" if path else name
        inner = _section(schema, defs)
        meaning = schema.get("description") or (inner or {}).get("description", "")
        if "set it as `" in meaning:  # belongs to another section
            continue
        default = schema.get("default")
        shown = "" if name in required or inner else _flow(default)
        if name in required:
            shown = "required"
        yield Key(
            here,
            _type(schema, defs).replace("|", "\\|"),
            next((unit for end, unit in UNITS.items() if re.search(rf"(^|_){end}$", name)), ""),
            shown if default is not None or name in required else "",
            " ".join(meaning.replace("``", "`").split()).replace("|", "\\|"),
            _example(here, files) or EXAMPLES.get(here, "") or ("" if inner else _flow(default)),
        )
        if inner:
            nested.append((inner, here))
    for inner, here in nested:
        yield from _keys(inner, defs, here, files)


def _section(schema: Mapping[str, Any], defs: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The section that a key holds, or holds a list of; None for a plain value."""
    if "$ref" in schema:
        found: Mapping[str, Any] = defs[schema["$ref"].rpartition("/")[2]]
        return found if "properties" in found else None
    for part in (*schema.get("anyOf", ()), schema.get("items", {})):
        inner = _section(part, defs) if part else None
        if inner:
            return inner
    return None


def _type(schema: Mapping[str, Any], defs: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return "section"
    if "enum" in schema:
        return " or ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    if "anyOf" in schema:
        parts = [_type(part, defs) for part in schema["anyOf"] if part.get("type") != "null"]
        return " or ".join(dict.fromkeys(parts))
    kind = schema.get("type", "any")
    if kind == "array":
        items: Mapping[str, Any] = schema.get("items") or next(
            iter(schema.get("prefixItems", ())), {}
        )
        many = len(schema.get("prefixItems", ()))
        name = _type(items, defs)
        return f"{many} × {name}" if many else f"list of {name}"
    bounds = [
        f"{sign} {schema[name]:g}"
        for name, sign in (
            ("exclusiveMinimum", ">"),
            ("minimum", "≥"),
            ("exclusiveMaximum", "<"),
            ("maximum", "≤"),
        )
        if name in schema
    ]
    names = {"string": "text", "integer": "whole number", "boolean": "true or false"}
    text = names.get(kind, {"object": "mapping"}.get(kind, kind))
    return " ".join([text, ", ".join(bounds)]).strip()


def _shipped(kind: str) -> Iterator[Any]:
    """The content of the shipped files of a kind."""
    folder, pattern = _FOLDERS.get(kind, ("recipes", "*.yaml"))
    model = KINDS[kind].__name__
    for path in sorted(packaged(folder).glob(pattern)):
        data = read_yaml(path).data
        if kind in _FOLDERS or (kind_of(data) or "Recipe") == model:
            yield data


def _example(path: str, files: list[Any]) -> str:
    """The first value of a key in the shipped files that fits into a table."""
    for data in files:
        values = [data]
        for name in path.split("."):
            lists = [value if isinstance(value, list) else [value] for value in values]
            values = [
                one[name] for many in lists for one in many if isinstance(one, dict) and name in one
            ]
        for value in values:
            if value is not None and len(text := _flow(value)) <= 60:
                return text
    return ""


def _flow(value: Any) -> str:
    """A value as YAML in one line."""
    if value is None or value in ("", [], {}):
        return ""
    text = yaml.safe_dump(value, default_flow_style=True, width=1000, allow_unicode=True)
    return text.removesuffix("\n").removesuffix("\n...").removesuffix("...").strip()
