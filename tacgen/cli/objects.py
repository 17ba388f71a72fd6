"""Commands for the objects to grasp."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from tacgen.cli import common


@common.objects_app.command("list")
def objects_list(json_output: common.JsonFlag = False) -> None:
    """List all objects: those that tacgen ships and those in ./objects."""
    from tacgen.objects.listing import object_rows, rows_text

    rows = object_rows()
    common.print_result(rows, rows_text(rows), json_output)
    common.hand_over(f"tacgen objects show {rows[0]['name']} --out {rows[0]['name']}.png")


@common.objects_app.command("show")
def objects_show(
    name: Annotated[
        str, Argument(help="Name of an object, or its folder.", autocompletion=common.object_names)
    ],
    out: Annotated[Path | None, Option(help="Also write a picture of the object (PNG).")] = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Show the properties of an object, each with its source."""
    from tacgen.core.resources import find_object_folder
    from tacgen.objects import load_object
    from tacgen.objects.description import read_description
    from tacgen.objects.listing import facts_text, object_facts
    from tacgen.objects.picture import write_picture

    obj = load_object(name)
    facts = object_facts(obj, read_description(find_object_folder(name)))
    if out is not None:
        write_picture(obj, out)
    common.print_result(facts, facts_text(facts), json_output)
    common.hand_over(common.IN_RECIPE, f"objects: [{obj.name}]")


@common.objects_app.command("add")
def objects_add(
    mesh: Annotated[
        Path, Argument(help="Mesh (OBJ, STL, PLY, GLB), URDF, or a folder or tree of them.")
    ],
    mass_kg: Annotated[
        float, Option("--mass", help="Mass of the object, or of each in a folder, kg.")
    ],
    scale: Annotated[
        float | None,
        Option(
            help="Millimetres per unit of the mesh: 1000 for metres; default: 1, of a URDF 1000."
        ),
    ] = None,
    name: Annotated[
        str | None, Option(help="Name of the object; default: the mesh file's name.")
    ] = None,
    friction: Annotated[float, Option(help="Coulomb friction coefficient against the gel.")] = 0.4,
    up: Annotated[
        str | None, Option(help="Axis of the mesh that points up; default: y of a GLB, else z.")
    ] = None,
    yaw_rad: Annotated[
        float | None,
        Option(
            "--yaw",
            help="Angle about z along which the fingers shall close, rad; default: along x, or "
            "where the pads meet the object.",
        ),
    ] = None,
    keep_pose: Annotated[
        bool, Option("--keep-pose", help="Keep the mesh's pose even if it would topple.")
    ] = False,
    force: common.ForceFlag = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Import a mesh into ./objects; recipes can then name it."""
    from tacgen.core.errors import ObjectError
    from tacgen.core.progress import print_status
    from tacgen.objects.add import MeshFacts, add_object, meshes_in
    from tacgen.objects.description import read_description
    from tacgen.objects.listing import facts_text, object_facts
    from tacgen.objects.picture import write_picture

    (meshes, others), refused = meshes_in(mesh), list[str]()
    common.note(f"{one}: another mesh of the same object, not used" for one in others)
    if len(meshes) > 1 and name is not None:
        msg = f"{mesh}: --name is for one mesh, the folder has {len(meshes)}; leave it out"
        raise ObjectError(msg)
    facts = MeshFacts(mass_kg, scale, name, friction, up, yaw_rad, keep_pose)
    records, texts, done = [], [], list[str]()
    for number, path in enumerate(meshes, start=1):
        of = f" ({number} of {len(meshes)})" if len(meshes) > 1 else ""

        def on_step(step: str, where: str = f"{path.name}{of}") -> None:
            print_status(f"{where}: {step}")

        try:
            added = add_object(path, facts, force=force, on_step=on_step)
        except ObjectError as error:
            refused.append(str(error))
            continue
        common.note(added.notes)
        folder = Path("objects") / added.object.name
        known = object_facts(added.object, read_description(folder))
        write_picture(added.object, folder / "picture.png", added.toppled_from)
        records.append(known)
        texts.append(facts_text(known))
        done.append(added.object.name)
    if not done:
        raise ObjectError.from_problems(refused)
    common.warn(refused, "refused")
    common.print_result(records if mesh.is_dir() else records[0], texts, json_output)
    common.hand_over(
        *(f"look at objects/{one}/picture.png" for one in done),
        common.IN_RECIPE,
        f"objects: [{', '.join(done)}]",
    )
