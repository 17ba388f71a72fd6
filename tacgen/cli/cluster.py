"""Commands for batch jobs: submit a recipe or a command, show its progress."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.errors import ClusterError

COMMAND_SETTINGS: dict[str, Any] = {"time_min": 480, "mem_gb": 16.0, "cpus_per_task": 4}
"""Default resources of the job of a command: enough to train a network on one GPU."""


@common.app.command(rich_help_panel=common.CLUSTER)
def submit(
    work: Annotated[
        list[str],
        Argument(
            metavar="RECIPE | -- COMMAND …",
            help="A recipe, to collect its dataset; or, after `--`, a friction or train command "
            "without `tacgen`.",
        ),
    ],
    out: Annotated[
        Path | None,
        Option(help="The dataset's folder, mounted on every machine; for a recipe only."),
    ] = None,
    executor: Annotated[str, Option(help="local or slurm.")] = "slurm",
    failed: Annotated[
        bool,
        Option("--failed", help="Submit only missing shards that are in no running or queued job."),
    ] = False,
    grow: Annotated[
        bool, Option("--grow", help="Add the grasps that the recipe's grid has gained.")
    ] = False,
    wait: Annotated[bool, Option("--wait", help="Wait; exit 1 if work is missing.")] = False,
    time_min: Annotated[
        int | None, Option(help="Minutes until a job is requeued; default for a command: 480.")
    ] = None,
    mem_gb: Annotated[
        float | None, Option(help="Memory of a job, GB; default for a command: 16.")
    ] = None,
    cpus_per_task: Annotated[
        int | None, Option(help="Worker processes of a job; default for a command: 4 cores.")
    ] = None,
    gpus: Annotated[int | None, Option(min=0, help="Number of GPUs, for a command only.")] = None,
    partition: Annotated[str | None, Option(help="Slurm partition.")] = None,
    account: Annotated[str | None, Option(help="Slurm account.")] = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Submit a recipe's missing shards, or a long command, to a scheduler.

    `tacgen submit RECIPE --out DIR`, where flags override the recipe's section `cluster`, or
    `tacgen submit --gpus 1 -- train RECIPE --data DIR --out RUN`.
    """
    from tacgen.cluster import states, submission
    from tacgen.collection.recipe import Cluster, cluster_section, load_recipe, with_cluster

    settings: dict[str, Any] = {"time_min": time_min, "mem_gb": mem_gb}
    settings |= {"cpus_per_task": cpus_per_task, "partition": partition, "account": account}
    is_recipe = out is not None
    if out is not None:
        if gpus is not None:
            msg = "--gpus: only for a command; set a recipe's GPUs in its section cluster.sbatch"
            raise ClusterError(msg)
        if len(work) != 1:
            msg = f"`{' '.join(work)}`: with --out, give exactly one recipe"
            raise ClusterError(msg)
        loaded = with_cluster(load_recipe(work[0]), **settings)
        submitted = submission.submit(loaded, out, executor, failed_only=failed, grow=grow)
        if not submitted.shards:
            typer.echo("tacgen: nothing to submit: every shard is done or in a job", err=True)
        common.print_record(asdict(submitted), json_output)
    else:
        if failed or grow:
            msg = f"--{'failed' if failed else 'grow'}: only for a recipe; remove it"
            raise ClusterError(msg)
        submission.require_command(work)
        commands: Any = typer.main.get_command(common.app)
        # Wrong options raise an error here, as when the command itself is called.
        out = Path(commands.commands[work[0]].make_context(work[0], work[1:]).params["out"])
        sbatch = {"gpus": gpus} if gpus else None
        section = cluster_section(Cluster(**COMMAND_SETTINGS), **settings, sbatch=sbatch)
        submitted = submission.submit_command(work, out, _run_command, executor, section)
        record = {"folder": submitted.folder, "executor": executor, "job": submitted.jobs[0]}
        common.print_record(record, json_output)
    common.hand_over(f"tacgen status {quoted(out)}")
    if wait:
        if is_recipe:
            found = submission.wait_for(out)
            is_whole, text = not found.not_begun, states.status_text(found)
        else:
            jobs = submission.wait_for_command(out)
            is_whole, text = jobs[-1].state == "done", states.jobs_text(out, jobs)
        typer.echo(text, err=True)
        if not is_whole:
            raise typer.Exit(1)


def _run_command(arguments: Sequence[str]) -> None:
    """Run a command inside a job; its errors go to the job's record."""
    common.app(list(arguments), standalone_mode=False)


@common.app.command(rich_help_panel=common.CLUSTER)
def status(
    folder: Annotated[Path, Argument(help="Folder of a dataset, or --out of a submitted command.")],
    json_output: common.JsonFlag = False,
) -> None:
    """Show the progress of a dataset or of jobs: done, running, failed and why, time left."""
    from tacgen.cluster import states

    jobs = () if (folder / "dataset.json").exists() else states.job_states(folder)
    if jobs:
        record = {"root": str(folder), "jobs": [asdict(job) for job in jobs]}
        common.print_result(record, states.jobs_text(folder, jobs), json_output)
    else:
        found = states.status(folder)
        common.print_result(found.as_dict(), states.status_text(found), json_output)
        common.hand_over(f"tacgen inspect {quoted(folder)}")
