"""What tacgen says when it refuses or warns: whole messages, in one approved table.

``with refused(PressError): ...`` compares the whole message with the row of ``messages.txt`` that
is named like the test. ``make messages`` writes the table anew: read its diff as a user would.
"""

from __future__ import annotations

import fcntl
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

TABLE = Path(__file__).with_name("messages.txt")
APPROVE = "TACGEN_APPROVE_MESSAGES"
PLACES = {
    re.escape(sys.executable): "PYTHON",
    re.escape(str(Path(__file__).parents[1])): "CHECKOUT",
    rf"{re.escape(tempfile.gettempdir())}/(tacgen-[a-z]+-\w+|pytest-of-\w+/pytest-\d+/\w+)": "TMP",
    r"\b\d+\.\d+\.\d+\b": "VERSION",
    r"\b[0-9a-f]{64}\b": "HASH",
    r"\bclient \d+": "client CLIENT",
}
"""Patterns of what differs between machines or runs, and what stands for it in the table."""
INDENT = "    "
_counts: dict[str, int] = {}


def read_table() -> dict[str, str]:
    """Each message by its row: the test's name and, from its second message on, a number."""
    rows: dict[str, list[str]] = {}
    row = ""
    for line in TABLE.read_text().splitlines() if TABLE.exists() else ():
        if line.startswith(("tests/", "validation/")):
            row = line
            rows[row] = []
        elif line:
            rows[row].append(line.removeprefix(INDENT))
    return {row: "\n".join(lines) for row, lines in rows.items()}


def write_table(rows: dict[str, str]) -> None:
    """Sorted by row."""
    text = "\n\n".join(
        "\n".join([row, *(INDENT + line for line in rows[row].splitlines())])
        for row in sorted(rows)
    )
    whole = TABLE.with_suffix(".part")
    whole.write_text(f"{text}\n")
    whole.replace(TABLE)


def approve(changed: dict[str, str], gone: list[str]) -> None:
    """Changes the table, as one of several processes."""
    with (TABLE.parent / "messages.py").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        write_table({k: v for k, v in read_table().items() if k not in gone} | changed)


def stale(items: list[pytest.Item]) -> list[str]:
    """Rows of which no test is left, in files that are gone or whose tests were all collected."""
    named = {item.nodeid for item in items}
    files = {name.split("::")[0] for name in named}
    rows = {row: Path(row.split("::")[0]) for row in read_table()}
    left = (row for row, file in rows.items() if str(file) in files or not file.exists())
    return [row for row in left if row.rsplit(" #", 1)[0] not in named]


def compare(message: str, hide: str) -> None:
    """The message with the running test's next row."""
    test = os.environ["PYTEST_CURRENT_TEST"].rsplit(" ", 1)[0]
    if test not in _counts:
        _counts.clear()
    _counts[test] = count = _counts.get(test, 0) + 1
    row = test if count == 1 else f"{test} #{count}"
    for pattern, name in PLACES.items():
        message = re.sub(pattern, name, message)
    if hide:
        message, found = re.subn(hide, "…", message)
        assert found, f"nothing to hide: no {hide!r} in {message!r}"
    message = "\n".join(line for line in message.splitlines() if line)
    if os.environ.get(APPROVE):
        approve({row: message}, [])
    else:
        assert message == read_table().get(row, "(not in tests/messages.txt: make messages)")


@contextmanager
def refused(
    kind: type[Exception] | tuple[type[Exception], ...], *, hide: str = ""
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """An error whose whole message is approved; ``hide`` is what no two machines say alike."""
    with pytest.raises(kind) as caught:
        yield caught
    compare(str(caught.value), hide)


@contextmanager
def warned(kind: type[Warning] = UserWarning, *, hide: str = "") -> Iterator[None]:
    """Warnings whose whole messages are approved."""
    with pytest.warns(kind) as caught:
        yield
    for one in caught:
        compare(str(one.message), hide)
