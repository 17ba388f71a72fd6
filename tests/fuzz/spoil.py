"""Reads files spoiled at random: ``python -m tests.fuzz.spoil FOLDER SEED SECONDS READER ...``.

Prints, as JSON, for each reader: how many were read, how many refused, the memory taken on top, and
the first failure: an exception that is no ``TacgenError``, or an input that took too long.

Each reader has a copy of one process that has imported everything, which takes longer than reading.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import resource
import signal
import sys
import time
import traceback
import zipfile
from pathlib import Path

import numpy as np

from tacgen.core.errors import TacgenError
from tests.fuzz.readers import READERS

PATIENCE_S = 20
LEAST = 20
"""Inputs, however long they take."""
MEMORY_BYTES = 2 << 30
TOKENS = [
    *(b"nan", b"inf", b"-1", b"0", b"1e309", b"99999999999999999999", b"2000000000", b"1e-320"),
    *(b"null", b"[]", b"{}", b'""', b"true", b"!!python/object/apply:os.system [x]", b"*a"),
    *(b"&a", b"a: " * 9, b"../../x", b"/etc/passwd", b"\xff\xfe", b"\x00", b"[" * 3000),
    *(b"\xf0\x9f\xa4\x96", b"\n", b",", b": ", b"  - ", b'"', b"2024-01-01", b"0x10", b"1:30"),
    *(b"!!bool foo", b"!!timestamp x", b'!!int ""', b"!!set {a}", b"9" * 5000, b'"\\uD800"'),
]


def spoiled(sound: bytes, rng: np.random.Generator) -> bytes:
    """``sound`` with one to four pieces cut, changed, doubled or replaced."""
    if sound[:2] == b"PK" and rng.random() < 0.7:
        return _spoiled_archive(sound, rng)
    data = bytearray(sound)
    for _ in range(rng.integers(1, 5)):
        start = int(rng.integers(len(data) + 1))
        length = int(rng.integers(1, 40))
        piece = TOKENS[rng.integers(len(TOKENS))]
        match rng.integers(6):
            case 0:
                del data[start:]
            case 1:
                data[start : start + length] = rng.bytes(length)
            case 2:
                data[start : start + length] = b""
            case 3:
                data[start:start] = data[start : start + length]
            case 4:
                data[start : start + int(rng.integers(6))] = piece
            case _:
                data[start:start] = piece
    return bytes(data)


def _spoiled_archive(sound: bytes, rng: np.random.Generator) -> bytes:
    """One member of a .zip spoiled, its checksum made right again."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(sound)) as old, zipfile.ZipFile(out, "w") as new:
        names = old.namelist()
        victim = names[rng.integers(len(names))]
        for name in names:
            content = old.read(name)
            if name == victim:
                head = min(len(content), 128)
                content = _spoiled_head(content[:head], rng) + content[head:]
            new.writestr(name, content)
    return out.getvalue()


def _spoiled_head(head: bytes, rng: np.random.Generator) -> bytes:
    """The shape and type that an array file states, changed; or anything else of it."""
    if rng.random() < 0.5:
        digits = [k for k, byte in enumerate(head) if 48 <= byte < 58]
        if digits:
            place = digits[rng.integers(len(digits))]
            return head[:place] + b"%d" % rng.integers(0, 10**9) + head[place + 1 :]
    return spoiled(head, rng)


def _too_long(_signal: int, _frame: object) -> None:
    msg = f"not through after {PATIENCE_S} s"
    raise TimeoutError(msg)


def _status_kb(name: str) -> int:
    text = Path("/proc/self/status").read_text()
    return int(text.split(f"{name}:")[1].split()[0])


def main(folder: Path, seed: int, seconds: float, names: list[str]) -> dict[str, dict[str, object]]:
    """What each reader made of the files; that of one that crashed is its exit code."""
    paths = {}
    for name in names:
        (folder / name).mkdir()
        paths[name] = READERS[name].make(folder / name)
        with contextlib.suppress(TacgenError):
            READERS[name].read(paths[name])
    return {name: _in_a_copy(name, path, seed, seconds) for name, path in paths.items()}


def _in_a_copy(name: str, path: Path, seed: int, seconds: float) -> dict[str, object]:
    result = path.with_name("told.json")
    child = os.fork()
    if child == 0:
        result.write_text(json.dumps(_spoil(name, path, seed, seconds)))
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    told: dict[str, object] = {"failure": f"ended with exit code {code}"}
    return told if code else json.loads(result.read_text())


def _spoil(name: str, path: Path, seed: int, seconds: float) -> dict[str, object]:
    """Spoil and read until the time is up, ``LEAST`` times at least, or something fails."""
    reader = READERS[name]
    sound = path.read_bytes()
    # Again in this process: what it touches for the first time counts as its memory.
    with contextlib.nullcontext() if reader.sound else contextlib.suppress(TacgenError):
        reader.read(path)
    size = _status_kb("VmSize") * 1024 + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (size, size))
    signal.signal(signal.SIGALRM, _too_long)
    rng = np.random.default_rng(seed)
    peak_before_kb = _status_kb("VmHWM")
    told: dict[str, object] = {"read": 0, "refused": 0, "failure": ""}
    end_s = time.process_time() + seconds
    for k in itertools.count():
        if told["failure"] or (k >= LEAST and time.process_time() > end_s):
            break
        path.write_bytes(spoiled(sound, rng))
        signal.alarm(PATIENCE_S)
        try:
            reader.read(path)
            told["read"] += 1  # type: ignore[operator]
        except TacgenError:
            told["refused"] += 1  # type: ignore[operator]
        except BaseException:
            told["failure"] = traceback.format_exc()
            path.with_name("failure.bin").write_bytes(path.read_bytes())
        signal.alarm(0)
    told["extra_mb"] = (_status_kb("VmHWM") - peak_before_kb) / 1024
    return told


if __name__ == "__main__":
    found = main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), sys.argv[4:])
    sys.stdout.write(json.dumps(found) + "\n")
