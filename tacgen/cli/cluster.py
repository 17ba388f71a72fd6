"""Commands for batch jobs: submit a recipe or a command, show its progress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from tacgen.cli.app import CLUSTER, JsonFlag, app, hand_over, print_record, print_result
from tacgen.core.errors import ClusterError

COMMAND_SETTINGS = {"time_min": 480, "mem_gb": 16.0, "cpus_per_task": 4}
"""Default resources of the job of a command: enough to train a network on one GPU."""


@app.command(rich_help_panel=CLUSTER)
def submit(
    work: Annotated[
        list[str],
        typer.Argument(
            metavar="RECIPE | -- COMMAND …",
            help="A recipe, to collect its dataset; or, after `--`, a friction or train command "
            "without `tacgen`.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="The dataset's folder, mounted on every machine; for a recipe only."),
    ] = None,
    executor: Annotated[str, typer.Option(help="local or slurm.")] = "slurm",
    failed: Annotated[
        bool,
        typer.Option(
            "--failed", help="Submit only missing shards that are in no running or queued job."
        ),
    ] = False,
    wait: Annotated[
        bool, typer.Option("--wait", help="Wait until the jobs end; exit 1 if work is missing.")
    ] = False,
    time_min: Annotated[
        int | None,
        typer.Option(help="Minutes until a job is requeued; default for a command: 480."),
    ] = None,
    mem_gb: Annotated[
        float | None, typer.Option(help="Memory of a job, GB; default for a command: 16.")
    ] = None,
    cpus_per_task: Annotated[
        int | None, typer.Option(help="Worker processes of a job; default for a command: 4 cores.")
    ] = None,
    gpus: Annotated[
        int | None, typer.Option(min=0, help="Number of GPUs, for a command only.")
    ] = None,
    partition: Annotated[str | None, typer.Option(help="Slurm partition.")] = None,
    account: Annotated[str | None, typer.Option(help="Slurm account.")] = None,
    max_array: Annotated[
        int | None, typer.Option(help="Maximum number of jobs in one array.")
    ] = None,
    shards_per_task: Annotated[int | None, typer.Option(help="Number of shards per job.")] = None,
    json_output: JsonFlag = False,
) -> None:
    """Submit a recipe's missing shards, or a long command, to a scheduler.

    `tacgen submit RECIPE --out DIR`, where flags override the recipe's section `cluster`, or
    `tacgen submit --gpus 1 -- train RECIPE --data DIR --out RUN`.
    """
    settings: dict[str, Any] = {
        "time_min": time_min,
        "mem_gb": mem_gb,
        "cpus_per_task": cpus_per_task,
        "partition": partition,
        "account": account,
    }
    if out is None:
        of_recipes = {"--failed": failed, "--max-array": max_array}
        _refuse(of_recipes | {"--shards-per-task": shards_per_task}, "a recipe")
        settings = {**COMMAND_SETTINGS, **{k: v for k, v in settings.items() if v is not None}}
        _submit_command(work, executor, wait, settings, gpus, json_output)
        return
    _refuse({"--gpus": gpus}, "a command; for a recipe, set GPUs in its section cluster.sbatch")
    if len(work) != 1:
        msg = f"`{' '.join(work)}`: with --out, give exactly one recipe"
        raise ClusterError(msg)
    settings |= {"max_array": max_array, "shards_per_task": shards_per_task}
    _submit_recipe(work[0], out, executor, failed, wait, settings, json_output)


def _refuse(options: Mapping[str, object], owner: str) -> None:
    given = [name for name, value in options.items() if value not in (None, False)]
    if given:
        msg = f"{', '.join(given)}: only for {owner}; remove it"
        raise ClusterError(msg)


def _submit_recipe(
    recipe: str,
    out: Path,
    executor: str,
    failed: bool,
    wait: bool,
    settings: Mapping[str, Any],
    json_output: bool,
) -> None:
    from tacgen import cluster
    from tacgen.collection.recipe import load_recipe, with_cluster

    loaded = with_cluster(load_recipe(recipe), **settings)
    submitted = cluster.submit(loaded, out, executor, failed_only=failed)
    if not submitted.shards:
        text = "tacgen: nothing to submit: every shard is done or in a job"
        typer.echo(text, err=True)
    print_record(asdict(submitted), json_output)
    hand_over(f"tacgen status {out}")
    if wait:
        found = cluster.wait_for(out)
        typer.echo(cluster.status_text(found), err=True)
        if found.not_begun:
            raise typer.Exit(1)


def _submit_command(
    command: Sequence[str],
    executor: str,
    wait: bool,
    settings: Mapping[str, Any],
    gpus: int | None,
    json_output: bool,
) -> None:
    from tacgen import cluster
    from tacgen.collection.recipe import cluster_section

    cluster.require_command(command)
    commands: Any = typer.main.get_command(app)
    # Wrong options raise an error here, as when the command itself is called.
    context = commands.commands[command[0]].make_context(command[0], list(command[1:]))
    out = Path(context.params["out"])
    section = cluster_section(**settings, sbatch={"gpus": gpus} if gpus else None)
    submitted = cluster.submit_command(command, out, _run_command, executor, section)
    print_record(
        {"folder": submitted.folder, "executor": executor, "job": submitted.jobs[0]}, json_output
    )
    hand_over(f"tacgen status {out}")
    if wait:
        jobs = cluster.wait_for_command(out)
        typer.echo(cluster.jobs_text(out, jobs), err=True)
        if jobs[-1].state != "done":
            raise typer.Exit(1)


def _run_command(arguments: Sequence[str]) -> None:
    """Run a command inside a job; its errors go to the job's record."""
    app(list(arguments), standalone_mode=False)


@app.command(rich_help_panel=CLUSTER)
def status(
    folder: Annotated[
        Path, typer.Argument(help="Folder of a dataset, or --out of a submitted command.")
    ],
    json_output: JsonFlag = False,
) -> None:
    """Show the progress of a dataset or of jobs: done, running, failed and why, time left."""
    from tacgen import cluster

    jobs = () if (folder / "dataset.json").exists() else cluster.job_states(folder)
    if jobs:
        record = {"root": str(folder), "jobs": [asdict(job) for job in jobs]}
        print_result(record, cluster.jobs_text(folder, jobs), json_output)
    else:
        found = cluster.status(folder)
        print_result(found.as_dict(), cluster.status_text(found), json_output)
        hand_over(f"tacgen inspect {folder}")
