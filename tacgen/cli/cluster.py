"""Commands about batch jobs: hand a recipe to a scheduler, see how far it is."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from tacgen.cli.app import DatasetArgument, JsonFlag, RecipeArgument, app, print_record


@app.command(rich_help_panel="Datasets")
def submit(
    recipe: RecipeArgument,
    out: Annotated[Path, typer.Option(help="The dataset's folder, seen by every machine.")],
    executor: Annotated[str, typer.Option(help="local or slurm.")] = "slurm",
    failed: Annotated[
        bool, typer.Option("--failed", help="Only what no living job will make.")
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay until the jobs end; exit 1 if shards lack.")
    ] = False,
    time_min: Annotated[int | None, typer.Option(help="Minutes a job may take.")] = None,
    mem_gb: Annotated[float | None, typer.Option(help="Memory of a job.")] = None,
    cpus_per_task: Annotated[int | None, typer.Option(help="Processes of a job.")] = None,
    partition: Annotated[str | None, typer.Option(help="Slurm partition.")] = None,
    account: Annotated[str | None, typer.Option(help="Slurm account.")] = None,
    max_array: Annotated[int | None, typer.Option(help="Most jobs of one array.")] = None,
    shards_per_task: Annotated[int | None, typer.Option(help="Shards of one job.")] = None,
    json_output: JsonFlag = False,
) -> None:
    """Hand a recipe's missing shards to a scheduler; flags win over the section `cluster`."""
    from tacgen import cluster
    from tacgen.collection.recipe import load_recipe, with_cluster

    loaded = with_cluster(
        load_recipe(recipe),
        time_min=time_min,
        mem_gb=mem_gb,
        cpus_per_task=cpus_per_task,
        partition=partition,
        account=account,
        max_array=max_array,
        shards_per_task=shards_per_task,
    )
    submitted = cluster.submit(loaded, out, cluster.Request(executor, failed_only=failed))
    if not submitted.shards:
        typer.echo("tacgen: nothing to submit: every shard is there or in a living job", err=True)
    print_record(asdict(submitted), json_output)
    if wait:
        found = cluster.wait_for(out)
        typer.echo(cluster.status_text(found), err=True)
        if found.not_begun:
            raise typer.Exit(1)


@app.command(rich_help_panel="Networks")
def batch(
    command: Annotated[
        list[str], typer.Argument(help="friction … or train …, as after `tacgen`, behind `--`.")
    ],
    executor: Annotated[str, typer.Option(help="local or slurm.")] = "slurm",
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay until it ends; exit 1 if not done.")
    ] = False,
    time_min: Annotated[int, typer.Option(min=1, help="Minutes until it is put back.")] = 480,
    mem_gb: Annotated[float, typer.Option(min=0.1, help="Memory.")] = 16.0,
    cpus_per_task: Annotated[int, typer.Option(min=1, help="Processors.")] = 4,
    gpus: Annotated[int, typer.Option(min=0, help="GPUs.")] = 0,
    partition: Annotated[str | None, typer.Option(help="Slurm partition.")] = None,
    account: Annotated[str | None, typer.Option(help="Slurm account.")] = None,
    json_output: JsonFlag = False,
) -> None:
    """Hand a long command to a scheduler: `tacgen batch --gpus 1 -- train RECIPE --data … `."""
    from tacgen import cluster
    from tacgen.collection.recipe import cluster_section

    cluster.require_command(command)
    commands: Any = typer.main.get_command(app)
    # Wrong options end here, as they do when the command itself is called.
    context = commands.commands[command[0]].make_context(command[0], list(command[1:]))
    out = Path(context.params["out"])
    asked = cluster_section(
        time_min=time_min,
        mem_gb=mem_gb,
        cpus_per_task=cpus_per_task,
        partition=partition,
        account=account,
        sbatch={"gpus": gpus} if gpus else None,
    )
    submitted = cluster.submit_command(command, out, _run_command, executor, asked)
    print_record(
        {"folder": submitted.folder, "executor": executor, "job": submitted.jobs[0]}, json_output
    )
    if wait:
        jobs = cluster.wait_for_command(out)
        typer.echo(cluster.jobs_text(out, jobs), err=True)
        if jobs[-1].state != "done":
            raise typer.Exit(1)


def _run_command(words: Sequence[str]) -> None:
    """What a job does: the command, its errors left to the job's record."""
    app(list(words), standalone_mode=False)


@app.command(rich_help_panel="Datasets")
def status(folder: DatasetArgument, json_output: JsonFlag = False) -> None:
    """Show how far a dataset is, or submitted jobs: done, running, failed and why, time left."""
    from tacgen import cluster

    jobs = () if (folder / "dataset.json").exists() else cluster.job_states(folder)
    if jobs:
        record = {"root": str(folder), "jobs": [asdict(job) for job in jobs]}
        typer.echo(json.dumps(record) if json_output else cluster.jobs_text(folder, jobs))
        return
    found = cluster.status(folder)
    if json_output:
        typer.echo(json.dumps(found.as_dict(), indent=2))
    else:
        typer.echo(cluster.status_text(found))
