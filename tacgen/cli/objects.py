"""Commands about the objects to grasp."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from tacgen.cli.app import (
    JsonFlag,
    objects_app,
)


@objects_app.command("list")
def objects_list(json_output: JsonFlag = False) -> None:
    """List every object that can be grasped here: tacgen's and those in ./objects."""
    from tacgen.objects.listing import object_rows, rows_text

    rows = object_rows()
    typer.echo(json.dumps(rows, indent=2, ensure_ascii=False) if json_output else rows_text(rows))


@objects_app.command("show")
def objects_show(
    name: Annotated[str, typer.Argument(help="An object's name, or its folder.")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Also write a picture of it, as PNG.")
    ] = None,
    json_output: JsonFlag = False,
) -> None:
    """Show an object's figures, each with its source."""
    from tacgen.core.resources import find_object_folder
    from tacgen.objects import load_object
    from tacgen.objects.description import read_description
    from tacgen.objects.listing import facts_text, object_facts
    from tacgen.objects.picture import write_picture

    obj = load_object(name)
    facts = object_facts(obj, read_description(find_object_folder(name)))
    if out is not None:
        write_picture(obj, out)
    typer.echo(
        json.dumps(facts, indent=2, ensure_ascii=False) if json_output else facts_text(facts)
    )


@objects_app.command("add")
def objects_add(
    mesh: Annotated[Path, typer.Argument(help="An OBJ, STL, PLY or GLB file.")],
    mass_kg: Annotated[float, typer.Option("--mass", help="What the object weighs, kg.")],
    scale: Annotated[
        float, typer.Option("--scale", help="mm per unit of the mesh: 1000 for metres.")
    ] = 1.0,
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the object [default: the file's].")
    ] = None,
    friction: Annotated[
        float, typer.Option("--friction", help="Coulomb coefficient against the gel.")
    ] = 0.4,
    up: Annotated[
        str, typer.Option("--up", help="The mesh's axis that points up: x, y or z.")
    ] = "z",
    force: Annotated[bool, typer.Option("--force", help="Replace an object of that name.")] = False,
    json_output: JsonFlag = False,
) -> None:
    """Import a mesh of your own into ./objects, ready to be named in a recipe."""
    from tacgen.objects.add import add_object
    from tacgen.objects.description import read_description
    from tacgen.objects.listing import facts_text, object_facts

    typer.echo(f"tacgen: importing {mesh}; convex parts take up to a minute", err=True)
    added = add_object(
        mesh, mass_kg=mass_kg, scale=scale, name=name, friction=friction, up=up, force=force
    )
    for note in added.notes:
        typer.echo(f"tacgen: note: {note}", err=True)
    facts = object_facts(added.object, read_description(Path("objects") / added.object.name))
    typer.echo(
        json.dumps(facts, indent=2, ensure_ascii=False) if json_output else facts_text(facts)
    )
