"""Atheris on readers, one after the other: ``python -m tests.fuzz.led FOLDER RUNS READER ...``.

Each is a copy of one process that has imported everything with atheris' counters in it, which
takes longer than the runs themselves. Prints, as JSON, how each ended: 0 is well; what it said
stands in ``FOLDER/READER/log``.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path

import atheris

CHECKOUT = Path(__file__).parents[2]
# What numba compiles must stay as it is written.
COMPILED = [
    ".".join(path.relative_to(CHECKOUT).with_suffix("").parts)
    for path in CHECKOUT.glob("tacgen/**/*.py")
    if "njit" in path.read_text(encoding="utf-8")
]
COUNTED = {"include": ["tacgen"], "exclude": COMPILED}

with atheris.instrument_imports(**COUNTED):
    from tacgen.core.errors import TacgenError
    from tests.fuzz.readers import READERS


def main(folder: Path, runs: int, names: list[str]) -> dict[str, int]:
    """Fuzz every reader; an exception that is no ``TacgenError`` ends that reader's runs."""
    paths = {}
    for name in names:
        (folder / name / "corpus").mkdir(parents=True)
        paths[name] = path = READERS[name].make(folder / name)
        (folder / name / "corpus/sound").write_bytes(path.read_bytes())
        with atheris.instrument_imports(**COUNTED), contextlib.suppress(TacgenError):
            READERS[name].read(path)
    return {
        name: _fuzzed_in_a_copy(name, path, folder / name, runs) for name, path in paths.items()
    }


def _fuzzed_in_a_copy(name: str, path: Path, folder: Path, runs: int) -> int:
    child = os.fork()
    if child == 0:
        log = os.open(folder / "log", os.O_WRONLY | os.O_CREAT, 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        _fuzz(name, path, folder, runs)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _fuzz(name: str, path: Path, folder: Path, runs: int) -> None:
    def read(data: bytes) -> None:
        path.write_bytes(data)
        with contextlib.suppress(TacgenError):
            READERS[name].read(path)

    options = ["-seed=1", "-timeout=20", "-rss_limit_mb=4000", f"-artifact_prefix={folder}/"]
    atheris.Setup([name, f"-runs={runs}", *options, str(folder / "corpus")], read)
    atheris.Fuzz()


if __name__ == "__main__":
    ended = main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
    sys.stdout.write(json.dumps(ended) + "\n")
