"""Commands ended at random moments: do they end at once, leave nothing, and go on rightly?

``python -m validation.processes.random_kills --kills 100``

``train``, ``export``, ``calibrate``, ``diagnose``, ``rig`` and ``study`` on small inputs each get
SIGKILL, SIGTERM or Ctrl-C at a random moment of the time that they take once Python has started.
Wanted: the command ends within 10 s, with exit code 130 and one line where it can say anything;
5 s later none of its processes runs; after the same command again no temporary file is left, and
every result has the bytes of a run that nobody disturbed. A trial that ended before its signal
counts as such.
"""

import argparse
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer
import yaml

from tacgen.core.files import write_text

ROOT = Path(__file__).resolve().parents[2]
ENDS_WITHIN_S, GONE_WITHIN_S = 10.0, 5.0
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
COMMANDS = {
    "export": "export data --format {} --out out",
    "calibrate": "calibrate lookup session/presses --out out/table.npz",
    "diagnose": "diagnose contact session/press_log.csv --out out",
    "rig": "rig rig.yaml --out out",
    "train": "train train.yaml --data data --out out --workers 2",
    "study": "study study.yaml --out out --workers 2",
}
FORMATS = ("robomimic", "images", "lerobot", "webdataset")
COMPARED = (".csv", ".png", ".npz", ".npy", ".h5", ".hdf5", ".tar", ".safetensors", ".parquet")
"""Results whose bytes depend on the input alone; pages and logs state times and machines."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One command and its signal; ``problems`` is empty where all was as wanted."""

    command: str
    signal: str
    after_s: float
    problems: tuple[str, ...]
    was_amid: bool


def prepare(folder: Path) -> None:
    """Write the small inputs that the commands of ``COMMANDS`` take."""
    from tests.learning.conftest import collect, make_spec
    from tests.small_world import write_world

    write_world(folder)
    collect(folder / "data", make_spec())
    train = {"model": {"weights": "none"}, "input": {"size_px": [32, 40]}}
    train |= {"training": {"epochs": 2}}
    write_text(folder / "train.yaml", yaml.safe_dump({"name": "t", **train}))
    grid = {"force_n": [3, 8, 14, 25], "y_mm": [0, 3, 6, 9], "z_mm": [60, 90, 140]}
    data = {"sensor": "coarse", "grid": grid, "dataset": {"shard_size": 12}}
    data |= {"physics": {"lift_mm": 40, "success_rise_mm": 30}}
    study = {"name": "s", "objects": ["sugar_box"], "data": data, "train": train}
    write_text(folder / "study.yaml", yaml.safe_dump(study | {"rows": [{"name": "row"}]}))
    rig = yaml.safe_load((ROOT / "recipes/rig_images_with_forces.yaml").read_text("utf-8"))
    rig["schedule"] = rig.get("schedule", {}) | {"presses": 12}
    write_text(folder / "rig.yaml", yaml.safe_dump(rig))
    _command(folder, "rig rig.yaml --out session").wait()


def trials(
    folder: Path, kills: int, names: tuple[str, ...] = tuple(COMMANDS), seed: int = 0
) -> Iterator[Trial]:
    """Disturb each of the commands in turn, in a folder that ``prepare`` has filled."""
    rng = np.random.default_rng(seed)
    whole: dict[str, tuple[dict[str, str], float]] = {}
    for number in range(kills):
        turn, which = divmod(number, len(names))
        words = COMMANDS[names[which]].format(FORMATS[turn % len(FORMATS)])
        if words not in whole:
            run = _command(folder, words)
            wait_for_tacgen(run)
            started_s = time.monotonic()
            code = run.wait()
            if code:
                msg = f"tacgen {words}: undisturbed, it ends with {code}"
                raise RuntimeError(msg)
            whole[words] = _results(folder / "out"), time.monotonic() - started_s
            shutil.rmtree(folder / "out")
        results, takes_s = whole[words]
        after_s = float(rng.uniform(0.0, takes_s))
        trial = _trial(folder, words, results, after_s, SIGNALS[int(rng.integers(len(SIGNALS)))])
        if not trial.was_amid:  # it takes less than what was measured, on a machine more at rest
            whole[words] = results, after_s
        yield trial
        shutil.rmtree(folder / "out", ignore_errors=True)


def _trial(
    folder: Path, words: str, results: dict[str, str], after_s: float, number: signal.Signals
) -> Trial:
    problems = []
    run = _command(folder, words)
    wait_for_tacgen(run)
    time.sleep(after_s)
    was_amid = run.poll() is None
    # Ctrl-C reaches the whole group; other signals the one process that they are sent to.
    if was_amid:
        (os.killpg if number == signal.SIGINT else os.kill)(run.pid, number)
    try:
        code = run.wait(timeout=ENDS_WITHIN_S)
    except subprocess.TimeoutExpired:
        problems.append(f"runs on after {ENDS_WITHIN_S:g} s")
        os.killpg(run.pid, signal.SIGKILL)
        code = run.wait()
    said = (folder / "said.txt").read_text("utf-8", errors="replace")
    if code not in (0, 130 if number != signal.SIGKILL else -signal.SIGKILL):
        problems.append(f"exit code {code}: {said[-300:]}")
    if "Traceback" in said:
        problems.append(f"a traceback: {said[:300]}")
    ended_s = time.monotonic()
    while left := processes_of(run.pid):
        if time.monotonic() - ended_s > GONE_WITHIN_S:
            problems.append(f"processes {left} are still there after {GONE_WITHIN_S:g} s")
            break
        time.sleep(0.05)
    again = _command(folder, words).wait()
    said = (folder / "said.txt").read_text("utf-8", errors="replace")
    if again and not (code == 0 or "exists already" in said):
        problems.append(f"again: exit code {again}: {said[-300:]}")
    parts = [str(path.relative_to(folder)) for path in folder.rglob("*.part")]
    problems += [f"{path} is left" for path in parts]
    found = _results(folder / "out")
    if found != results:
        other = sorted(name for name in {*found, *results} if found.get(name) != results.get(name))
        problems.append(f"other results: {', '.join(other[:5])}")
    return Trial(words.split(" --out")[0], number.name, after_s, tuple(problems), was_amid)


def _command(folder: Path, words: str) -> "subprocess.Popen[bytes]":
    with (folder / "said.txt").open("wb") as said:
        return subprocess.Popen(
            [sys.executable, "-m", "tacgen", *words.split()],
            cwd=folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,
        )


def wait_for_tacgen(run: "subprocess.Popen[bytes]") -> None:
    """Return when the command answers signals; before, Python itself is starting."""
    status = Path(f"/proc/{run.pid}/status")
    while run.poll() is None:
        caught = re.search(r"SigCgt:\s*(\w+)", status.read_text("utf-8"))
        if caught and int(caught[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.005)


def processes_of(session: int) -> list[int]:
    """The processes of a session that still run."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text("utf-8", errors="replace").rpartition(")")[2]
        except OSError:
            continue
        state, _, _, of = fields.split()[:4]
        if int(of) == session and state != "Z":
            found.append(int(folder.name))
    return found


def _results(out: Path) -> dict[str, str]:
    return {
        str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(out.rglob("*"))
        if path.suffix in COMPARED
    }


def main() -> None:
    """Print a line a trial, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=list(COMMANDS), choices=list(COMMANDS))
    given = parser.parse_args()
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="kills-") as name:
        prepare(Path(name))
        for trial in trials(Path(name), given.kills, tuple(given.only), given.seed):
            counts["trials"] += 1
            counts["amid the work"] += trial.was_amid
            counts["with a problem"] += bool(trial.problems)
            what = "; ".join(trial.problems) or ("right" if trial.was_amid else "had ended before")
            typer.echo(f"{trial.command} {trial.signal} after {trial.after_s:.2f} s: {what}")
    typer.echo(", ".join(f"{count} {name}" for name, count in counts.items()))
    sys.exit(bool(counts["with a problem"]))


if __name__ == "__main__":
    main()
