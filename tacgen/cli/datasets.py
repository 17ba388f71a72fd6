"""Commands for datasets: plan, collect, inspect, verify, merge, export."""

import os
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.errors import TacgenError
from tacgen.core.files import refuse_existing


@common.app.command(rich_help_panel=common.DATASETS)
def collect(
    recipe: common.RecipeArgument,
    out: Annotated[Path, Option(help="Folder of the dataset; a stopped collection resumes.")],
    workers: common.WorkersOption = common.AUTO,
    shard: Annotated[
        str, Option(help="I/N: only part I of N (from 0); auto: the part of this job-array task.")
    ] = "0/1",
    dry_run: Annotated[bool, Option("--dry-run", help="Print the plan, collect nothing.")] = False,
    repair: Annotated[
        bool, Option("--repair", help="Verify the dataset first and collect damaged shards again.")
    ] = False,
    grow: Annotated[
        bool, Option("--grow", help="Add the grasps that the recipe's grid has gained.")
    ] = False,
    grasp_limit_s: Annotated[float, Option(min=1.0, help="Time limit of a grasp, s.")] = 120.0,
    json_output: common.JsonFlag = False,
) -> None:
    """Simulate the grasps of a recipe and write images, labels and forces as a dataset."""
    from tacgen.core.processes import start_early

    if not dry_run:
        start_early("tacgen.collection.run")
    from tacgen.collection.job_array import parse_share
    from tacgen.collection.recipe import load_recipe
    from tacgen.collection.run import collect as run
    from tacgen.collection.run import describe
    from tacgen.core.errors import VerificationError
    from tacgen.dataset.check import OUTCOME
    from tacgen.dataset.summary import (
        cut_off_line,
        none_executed,
        not_executed_lines,
        summarize,
        validity_lines,
    )
    from tacgen.dataset.verify import verify as check

    loaded = load_recipe(recipe)
    plan = describe(loaded, out)
    part, parts, origin = parse_share(shard, os.environ)
    share = range(part, plan["shards"], parts)
    if dry_run:
        common.print_record(plan, json_output)
        return
    if parts > 1:
        typer.echo(f"part {part} of {parts} ({origin}): {len(share)} shards", err=True)
    found = check(out) if repair else None
    redo = [number for number in found.bad_shards if number in share] if found else []
    result = run(
        loaded, out, workers=workers, shards=share, redo=redo, grow=grow,
        item_limit_s=grasp_limit_s, progress=not json_output,
    )  # fmt: skip
    record, summary = result.summary(), None
    if result.made or result.found:
        summary = summarize(out)
        counts, names = summary["counts"], ("successes", "failures", "not_executed")
        record["grasps_held"] = summary["grasps"]
        record |= dict(zip(names, map(counts.__getitem__, OUTCOME.values()), strict=True))
    common.print_record(record, json_output)
    if not share:
        typer.echo(f"nothing to do: part {part} of {parts} has no shard", err=True)
    if found and found.foreign:
        raise VerificationError.from_problems([f"{out}/{line}" for line in found.foreign])
    if summary is None:
        return
    common.note(cut_off_line(summary))
    common.warn([*not_executed_lines(summary), *validity_lines(summary)])
    if none_executed(summary):
        raise typer.Exit(1)
    common.hand_over(
        f"tacgen view {quoted(out)}   # the gallery, {out / 'index.html'}",
        f"tacgen inspect {quoted(out)}",
        _train_line(out),
    )


def _train_line(data: Path) -> str:
    return f"tacgen train train_single_small --data {quoted(data)} --out run"


@common.app.command(rich_help_panel=common.DATASETS)
def grid(
    recipe: common.RecipeArgument,
    near_border: Annotated[
        Path | None,
        Option(help="A dataset: list its grasps, and more where their labels leave it open."),
    ] = None,
    count: Annotated[int, Option(min=1, help="How many more of each object.")] = 20,
    json_output: common.JsonFlag = False,
) -> None:
    """List the grasps of a recipe with the shard of each, as CSV."""
    import pandas as pd

    from tacgen.collection.grid import grid_rows, grown_plan
    from tacgen.collection.pipeline import dataset_spec
    from tacgen.collection.recipe import load_recipe
    from tacgen.core.errors import PhysicsError, TacgenError
    from tacgen.core.progress import print_status
    from tacgen.physics import GraspSimulator

    loaded = load_recipe(recipe)
    if near_border is not None:
        from tacgen.collection.border import next_grasps

        found = next_grasps(loaded, near_border, count)
        text = found.to_csv(index=False).rstrip("\n")
        common.print_result(found.to_dict(orient="records"), text, json_output)
        common.hand_over(
            f"tacgen collect {quoted(recipe)} --out {quoted(near_border)} --grow   "
            "# with the list as grid.file in the recipe"
        )
        return
    plan = grown_plan(loaded, ())
    rows = grid_rows(plan.grasps)
    try:
        GraspSimulator(loaded.robot.spec(), loaded.physics.engine)
    except PhysicsError as error:  # the list is right all the same
        common.warn([error])
    common.print_result(rows, pd.DataFrame(rows).to_csv(index=False).rstrip("\n"), json_output)
    try:
        costs = dataset_spec(loaded, len(rows)).grasp_bytes.items()
        kept = ", ".join(f"{name} {n / 1e3:.1f} kB" for name, n in costs)
        print_status(f"a grasp before compression (`tacgen inspect` says what is stored): {kept}")
    except TacgenError as error:  # of a table, which the list of grasps can do without
        common.warn([error])
    common.hand_over(f"tacgen collect {quoted(recipe)} --out data")


@common.app.command(rich_help_panel=common.DATASETS)
def inspect(folder: common.DatasetArgument, json_output: common.JsonFlag = False) -> None:
    """Show the contents of a dataset: counts, labels by object, splits, sizes, origin."""
    from tacgen.dataset.summary import none_executed, summarize, summary_text

    summary = summarize(folder)
    common.print_result(summary, summary_text(summary), json_output)
    if none_executed(summary):
        raise typer.Exit(1)
    common.hand_over(f"tacgen verify {quoted(folder)}", _train_line(folder))


@common.app.command(rich_help_panel=common.DATASETS)
def verify(
    folder: common.DatasetArgument,
    decode: Annotated[bool, Option("--decode", help="Also decompress every image.")] = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Check every hash, shape and label; lists damaged shards and exits 1 if there are any."""
    from tqdm import tqdm

    from tacgen.core.errors import VerificationError
    from tacgen.dataset import verify as check

    with tqdm(unit="B", unit_scale=True, disable=None, leave=False) as bar:
        found = check.verify(folder, decode=decode, progress=bar.update)
    if found.problems and not json_output:
        raise VerificationError.from_problems(
            [
                f"{folder}: {len(found.problems)} problems, {len(found.bad_shards)} bad shards",
                *(f"  {problem.file}: {problem.reason}" for problem in found.problems),
                "`tacgen collect` makes missing shards; `--repair` also remakes damaged ones",
            ]
        )
    text = f"{found.n_grasps} grasps in {found.n_shards} shards, all intact"
    common.print_result(found.as_dict(), text, json_output)
    if found.problems:
        raise typer.Exit(1)
    common.hand_over(_train_line(folder))


@common.app.command(rich_help_panel=common.DATASETS)
def merge(folder: common.DatasetArgument) -> None:
    """Join the manifest lines of all shards, from all machines, in manifest.jsonl."""
    from tacgen.dataset import DatasetFolder

    lines = DatasetFolder(folder).merge()
    typer.echo(f"{folder}/manifest.jsonl: {len(lines)} shards")
    common.hand_over(f"tacgen verify {quoted(folder)}")


@common.app.command(rich_help_panel=common.DATASETS)
def export(
    folder: common.DatasetArgument,
    out: Annotated[Path, Option(help="Folder to write; it must not exist yet.")],
    format_name: Annotated[
        str,
        Option(
            "--format",
            help="lerobot, images (PNG and CSV, with depth and forces), webdataset, robomimic, or "
            "real-grasps.",
        ),
    ] = "lerobot",
    split: Annotated[str | None, Option(help="Export only the train or the test grasps.")] = None,
    no_images: Annotated[bool, Option("--no-images", help="No images (real-grasps only).")] = False,
    json_output: common.JsonFlag = False,
) -> None:
    """Write the executed grasps of a dataset in another format."""
    from tacgen.dataset.export import export_dataset

    result = export_dataset(folder, out, format_name, split=split, images=not no_images)
    text = f"{out}: {result['content']}"
    if result["not_executed"]:
        text += f"; {result['not_executed']} grasps that were not executed are not exported"
    common.print_result(result, text, json_output)
    recipe = quoted(folder / "recipe.yaml")
    common.hand_over(_NEXT_BY_FORMAT[format_name].format(quoted(out), recipe=recipe))


_NEXT_BY_FORMAT = {
    "lerobot": "in Python, with lerobot: LeRobotDataset(repo_id='local', root='{}')",
    "images": "tacgen predict run {}/images/*",
    "webdataset": "in Python, with webdataset: WebDataset of the .tar files in {}",
    "robomimic": "python -m robomimic.scripts.get_dataset_info --dataset {}/grasps.hdf5",
    "real-grasps": "tacgen friction {recipe} --real {} --out friction",
}


@common.app.command(rich_help_panel=common.DATASETS)
def view(
    folder: common.DatasetArgument,
    grasp: Annotated[int | None, Option(help="Show one grasp, with depth and forces.")] = None,
    rerun: Annotated[
        bool, Option("--rerun", help="Show the grasp in motion, in Rerun (the extra `view`).")
    ] = False,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Only write and print the path.")
    ] = False,
) -> None:
    """Open the gallery of a dataset, or a page of one grasp, in the browser or in Rerun."""
    import subprocess
    import sys
    import webbrowser

    from tacgen.core.errors import DatasetError
    from tacgen.dataset.grasp_page import write_grasp_page

    if rerun:
        from tacgen.collection.rerun_recording import write_recording

        recording = folder / f"grasp-{grasp or 0:05d}.rrd"
        write_recording(folder, grasp or 0, recording)
        typer.echo(str(recording))
        common.hand_over(f"rerun {quoted(recording)}")
        if not no_browser:
            subprocess.run([sys.executable, "-m", "rerun", str(recording)], check=False)
        return
    page = folder / ("index.html" if grasp is None else f"grasp-{grasp:05d}.html")
    if grasp is not None:
        write_grasp_page(folder, grasp, page)
    if not page.is_file():
        msg = f"{page}: there is no gallery; `tacgen collect` writes it when it has finished"
        raise DatasetError(msg)
    typer.echo(str(page))
    common.hand_over(
        f"tacgen verify {quoted(folder)}" if grasp is None else f"tacgen view {quoted(folder)}"
    )
    if not no_browser:
        webbrowser.open(page.resolve().as_uri())


@common.app.command(rich_help_panel=common.DATASETS)
def render(
    recipe: common.RecipeArgument,
    out: Annotated[Path, Option("--gif", help="Animation (GIF) to write.")],
    grasp: Annotated[int, Option(min=0, help="Number of the grasp.")] = 0,
    force: common.ForceFlag = False,
) -> None:
    """Simulate one grasp of a recipe and write its tactile images as an animation."""
    from tacgen.collection.grasp_gif import write_gif
    from tacgen.collection.recipe import load_recipe

    if out.suffix.lower() != ".gif":
        msg = f"--gif {out}: only GIF is written; give a name that ends in .gif"
        raise TacgenError(msg)
    refuse_existing(force, out)
    outcome = write_gif(load_recipe(recipe), grasp, out)
    typer.echo(f"{out}: grasp {grasp}, {outcome}")
    common.hand_over(f"tacgen collect {quoted(recipe)} --out data")
