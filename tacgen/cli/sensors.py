"""Commands for the sensors that recipes name."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from tacgen.cli import common


@common.sensors_app.command("list")
def sensors_list(json_output: common.JsonFlag = False) -> None:
    """List all sensors: those that tacgen ships and those in ./recipes/sensors."""
    from tacgen.sensor.listing import rows_text, sensor_rows

    rows = sensor_rows()
    common.print_result(rows, rows_text(rows), json_output)
    common.hand_over(f"tacgen sensors show {rows[0]['name']} --out {rows[0]['name']}.png")


@common.sensors_app.command("show")
def sensors_show(
    name: Annotated[
        str,
        Argument(help="Name of a sensor, or path of its YAML.", autocompletion=common.sensor_names),
    ],
    out: Annotated[
        Path | None, Option(help="Also write pictures of a ball pressed in by three forces (PNG).")
    ] = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Show a sensor's geometry and where its colours come from, with their error."""
    from tacgen.sensor.listing import facts_text, sensor_facts, write_picture

    facts = sensor_facts(name)
    if out is not None:
        write_picture(name, out)
    common.print_result(facts, facts_text(facts), json_output)
    common.hand_over(common.IN_RECIPE, f"sensor: {name}")


@common.sensors_app.command("add")
def sensors_add(
    table: Annotated[Path, Argument(help="Table of `tacgen calibrate lookup` (table.npz).")],
    name: Annotated[str, Option(help="Name of the sensor, for recipes.")],
    gel_depth_mm: Annotated[
        float, Option(help="Thickness of the gel, the largest indentation, mm.", min=0.1)
    ] = 2.0,
    dome_radius_mm: common.DomeRadiusOption = None,
    force: common.ForceFlag = False,
) -> None:
    """Add a sensor to ./recipes/sensors from a calibrated table; recipes can then name it."""
    from tacgen.sensor.listing import add_sensor

    written = add_sensor(
        table, name, gel_depth_mm=gel_depth_mm, dome_radius_mm=dome_radius_mm, force=force
    )
    common.print_result({"file": str(written)}, str(written), False)
    common.hand_over(
        f"tacgen sensors show {name} --out {name}.png", common.IN_RECIPE, f"sensor: {name}"
    )
