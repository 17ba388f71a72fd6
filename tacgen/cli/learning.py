"""Commands for the networks: train, evaluate, run studies."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.errors import LearningError

DeviceOption = Annotated[
    Literal["auto", "cpu", "cuda"] | None,
    Option(help="Device, in place of the training recipe's training.device."),
]


@common.app.command(rich_help_panel=common.NETWORKS)
def train(
    recipe: Annotated[str, Argument(help="Training recipe: YAML, or a shipped one's name.")],
    data: Annotated[Path, Option(help="Dataset that `tacgen collect` wrote.")],
    out: Annotated[Path, Option(help="Folder of the run; an interrupted training is resumed.")],
    workers: common.WorkersOption = common.AUTO,
    device: DeviceOption = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Train networks that predict from tactile images whether a grasp will hold."""
    from tacgen.learning import require_learning_extra
    from tacgen.learning.training_recipe import load_train_recipe

    require_learning_extra()
    from tacgen.learning.scores import training_lines
    from tacgen.learning.train import train as train_models

    loaded = load_train_recipe(recipe)
    summary = train_models(loaded, data, out, workers=workers, device=device)
    common.print_result(summary, training_lines(summary), json_output)
    common.hand_over(f"tacgen eval {quoted(out)} --data {quoted(data)}")


@common.app.command("eval", rich_help_panel=common.NETWORKS)
def evaluate(
    run: Annotated[Path | None, Argument(help="Folder of a run that `tacgen train` wrote.")] = None,
    data: Annotated[Path | None, Option(help="Test on the test grasps of this dataset.")] = None,
    real: Annotated[Path | None, Option(help="Test on the real grasps in this folder.")] = None,
    baseline: Annotated[
        Literal["parameters"] | None,
        Option(
            help="parameters: instead of a RUN, cross-validate decision trees on the force and "
            "position (no image) of each training grasp in --data."
        ),
    ] = None,
    across: Annotated[
        list[str] | None,
        Option(
            help="Test although the images of --data were taken with another one of sensor, table, "
            "pad, markers, shadows, time_s, until; may be repeated."
        ),
    ] = None,
    controls: Annotated[
        bool,
        Option(
            "--controls",
            help="Also score networks trained on shuffled labels and on constant images, and trees "
            "that see the force alone; on the run's dataset if no --data is given.",
        ),
    ] = False,
    device: DeviceOption = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Test a run on simulated or real grasps; once both are tested, prints the sim-to-real gap."""
    from tacgen.learning import require_learning_extra

    require_learning_extra()
    if baseline is not None:
        from tacgen.learning.grasps import SimulatedGrasps
        from tacgen.learning.parameter_baseline import baseline_lines, baseline_scores
        from tacgen.learning.twins import equal_ranges, one_sided

        if data is None or run is not None or real is not None:
            msg = "--baseline takes no RUN and no --real; give a dataset with --data DIR"
            raise LearningError(msg)
        source = SimulatedGrasps(data)
        equal = equal_ranges(source)
        table, _ = one_sided(source.table, equal)
        scores = baseline_scores(table, equal)
        common.print_result(scores, baseline_lines(scores), json_output)
        common.hand_over(f"tacgen train train_single_small --data {quoted(data)} --out run")
        return
    if run is None:
        msg = "eval: give the RUN to test, a folder that `tacgen train --out` made"
        raise LearningError(msg)
    from tacgen.learning.evaluate import evaluate as evaluate_run
    from tacgen.learning.scores import evaluation_lines

    result = evaluate_run(run, data, real, device=device, across=across or (), controls=controls)
    common.print_result(result, evaluation_lines(result), json_output)
    lines = [f"tacgen export {quoted(data)} --format real-grasps --out grasps"] if not real else []
    common.hand_over(*lines, f"tacgen predict {quoted(run)} {quoted(real or 'grasps')}/images/*")


@common.app.command(rich_help_panel=common.NETWORKS)
def predict(
    run: Annotated[Path, Argument(help="Folder of a run that `tacgen train` wrote.")],
    images: Annotated[
        list[Path],
        Argument(help="Images, or folders of them; for a sequence network the frames of a grasp."),
    ],
    object_name: Annotated[
        str | None, Option("--object", help="Object whose model to use, if there are more.")
    ] = None,
    background: Annotated[
        Path | None, Option(help="Image of your gel at rest; else that of the training data.")
    ] = None,
    prior: Annotated[
        float | None,
        Option(help="Share of your grasps that hold; else that of the training grasps."),
    ] = None,
    device: DeviceOption = None,
    json_output: common.JsonFlag = False,
) -> None:
    """Predict from your own images the probability that each grasp will hold."""
    from tacgen.learning import require_learning_extra

    require_learning_extra()
    from tacgen.core.safe_io import read_rgb
    from tacgen.learning.predictor import Predictor, predict_files

    at_rest = None if background is None else read_rgb(background)
    predictor = Predictor(run, object_name, at_rest, device=device, prior=prior)
    rows = predict_files(predictor, images)
    lines = [f"{row['probability']:.3f}  {row['images']}" for row in rows]
    common.print_result(rows, lines, json_output)
    common.hand_over(
        "to learn how often it is right, list how the grasps ended in a grasps.csv beside images/,"
        f" and give their folder to `tacgen eval {quoted(run)} --real`"
    )


@common.app.command(rich_help_panel=common.NETWORKS)
def regrasp(
    run: Annotated[Path, Argument(help="Folder of a run that `tacgen train` wrote.")],
    recipe: common.RecipeArgument,
    out: common.ResultsOption,
    regrasps: Annotated[int, Option(min=0, max=9, help="Regrasps allowed before the lift.")] = 3,
    episodes: Annotated[int, Option(min=2, help="Episodes of each object.")] = 40,
    worlds: Annotated[int, Option(min=2, help="Simulated worlds to rate grasps by.")] = 32,
    drop_cost: Annotated[float, Option(help="Cost of a lift that fails.")] = 1.0,
    regrasp_cost: Annotated[float, Option(help="Cost of a regrasp.")] = 0.1,
    seed: Annotated[
        int | None, Option(min=0, help="Seed of episodes and worlds; else the recipe's.")
    ] = None,
    workers: common.WorkersOption = common.AUTO,
    json_output: common.JsonFlag = False,
) -> None:
    """Grasp, look, then lift or regrasp by a run's network; success against the first grasps."""
    from tacgen.learning import require_learning_extra

    require_learning_extra()
    from tacgen.collection.recipe import load_recipe
    from tacgen.envs.regrasp import Costs, Play, regrasp_lines
    from tacgen.envs.regrasp import regrasp as play_all

    play = Play(Costs(drop_cost, regrasp_cost), regrasps, episodes, worlds, seed)
    result = play_all(run, load_recipe(recipe), out, play, workers=workers)
    common.print_result(result, regrasp_lines(result), json_output)


@common.app.command(rich_help_panel=common.NETWORKS)
def study(
    recipe: Annotated[str, Argument(help="Study: YAML, or a shipped one, such as paper_table.")],
    out: Annotated[Path, Option(help="Folder for datasets, runs and the table.")],
    real: Annotated[Path | None, Option(help="Folder of real grasps to test on as well.")] = None,
    calibrate_on: Annotated[
        Path | None,
        Option(help="Folder of other real grasps, for rows that fit friction to real labels."),
    ] = None,
    contact: Annotated[Path | None, Option(help="contact.yaml, for rows that use it.")] = None,
    row: Annotated[list[str] | None, Option(help="Run this row only; may be repeated.")] = None,
    quick: Annotated[bool, Option("--quick", help="Run the study's reduced version.")] = False,
    workers: common.WorkersOption = common.AUTO,
    json_output: common.JsonFlag = False,
) -> None:
    """Collect, train and test every variant of a study; writes a table (Markdown, HTML, JSON)."""
    from tacgen.learning import require_learning_extra
    from tacgen.study.study_recipe import load_study

    require_learning_extra()
    from tacgen.study.real_data import RealData
    from tacgen.study.run import check_finished, run_study

    given = RealData(real, calibrate_on, contact)
    result = run_study(load_study(recipe), out, given, rows=row or (), quick=quick, workers=workers)
    common.print_result(result, (out / "table.md").read_text(encoding="utf-8"), json_output)
    check_finished(result)
    common.hand_over(f"open {out / 'index.html'} in a browser")
