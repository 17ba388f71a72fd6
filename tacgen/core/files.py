"""Files that appear whole or not at all, and hashes of what is on disk."""

import contextlib
import functools
import glob
import hashlib
import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from tacgen.core.errors import DatasetError, TacgenError
from tacgen.core.lock import alone

HEAD_BYTES = 500  # of a page, that hold its mark


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside ``path``; renamed to it on success, removed on failure.

    The content is flushed to disk before the rename, so that after a power loss ``path`` is
    either the old file or the whole new one. An ``OSError`` without a file's name gets this one.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_abandoned(path.parent)
    # Host and process: two machines that share the folder may share process numbers.
    partial = path.with_name(f".{path.name}.{socket.gethostname()}.{os.getpid()}.part")
    try:
        yield partial
        sync_file(partial)
        os.replace(partial, path)
        sync_file(path.parent)
    except OSError as error:
        if error.errno and (error.filename is None or Path(error.filename) == partial):
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


@functools.cache
def _remove_abandoned(folder: Path) -> None:
    """Remove the temporary files in ``folder`` of processes of this machine that are gone."""
    for partial in folder.glob(f".*.{glob.escape(socket.gethostname())}.*.part"):
        digits = partial.name.split(".")[-2]
        try:
            os.kill(int(digits), 0)
        except ProcessLookupError:
            partial.unlink(missing_ok=True)
        except (OSError, ValueError, OverflowError):
            continue


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside ``path``; renamed to it on success, removed on failure.

    What a killed process left of the same ``path`` is removed too. Raises ``TacgenError`` if
    ``path`` exists already, or another process is writing it.
    """
    path = Path(path)
    if os.path.lexists(path):
        msg = f"{path} exists already; give a new folder, or remove it"
        raise TacgenError(msg)
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(f".{path.name}.lock")
    with alone(lock, path, "writing it", TacgenError) as held:
        if held:
            for left in path.parent.glob(f".{glob.escape(path.name)}.????????.part"):
                shutil.rmtree(left, ignore_errors=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
        try:
            partial.chmod(0o755)
            yield partial
            for file in partial.rglob("*"):
                sync_file(file)
            os.replace(partial, path)
            sync_file(path.parent)
        except OSError as error:
            error.filename = error.filename or str(path)
            raise
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def sync_file(path: Path) -> None:
    """Make the content of ``path`` durable; of a folder, the names in it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write ``text`` as UTF-8, whole or not at all."""
    with atomic_path(path) as partial:
        partial.write_text(text, encoding="utf-8")


def append_json_lines(path: Path, lines: Iterable[object]) -> None:
    """Add lines of JSON to a file of finished work; one that was cut short is ended first."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        file.seek(max(0, file.tell() - 1))
        if file.read(1) not in (b"", b"\n"):
            file.write(b"\n")
        file.writelines(f"{json.dumps(line)}\n".encode() for line in lines)


def read_json_lines(path: Path) -> Iterator[Any]:
    """What each line of such a file holds, if there is one; damaged lines are passed over."""
    if path.is_file():
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with contextlib.suppress(ValueError, RecursionError):
                yield json.loads(line)


def refuse_foreign(folder: Path, mark: str, names: Iterable[str]) -> None:
    """Raise a ``TacgenError`` where files that are to be written are there, and are not tacgen's.

    They are its own where ``mark``, the first file that tacgen writes there, is there too.
    """
    there = [name for name in names if os.path.lexists(folder / name)]
    if there and not os.path.lexists(folder / mark):
        msg = (
            f"{folder / there[0]}: is there already, and not from a run of this command; give an "
            "empty or a new folder as --out"
        )
        raise TacgenError(msg)


def page_mark(made_by: str) -> str:
    """The line in the head of a page by which the command that wrote it is known."""
    return f'<meta name="generator" content="tacgen {made_by}">'


def refuse_other_page(path: Path, made_by: str) -> None:
    """Raise a ``TacgenError`` where a file ``path`` is no page that the command wrote."""
    if not os.path.lexists(path):
        return
    with path.open("rb") as file:
        if page_mark(made_by).encode() in file.read(HEAD_BYTES):
            return
    msg = (
        f"{path}: is there already, and not from `tacgen {made_by}`; move it, or give a new folder"
    )
    raise TacgenError(msg)


def require_readable(path: Path, error: type[TacgenError]) -> None:
    """Raise ``error`` where the file ``path`` may not be read: that is not damage."""
    if not os.access(path, os.R_OK):
        msg = f"{path}: permission denied; ask its owner for the right to read it"
        raise error(msg)


def refuse_existing(force: bool, *paths: Path) -> None:
    """Raise a ``DatasetError`` if one of ``paths`` exists and not ``force``."""
    there = [path for path in paths if os.path.lexists(path)]
    if there and not force:
        msg = f"{there[0]}: exists already; pass --force to replace it, or another --out"
        raise DatasetError(msg)


def is_file(path: Path) -> bool:
    """Whether ``path``, which somebody may have mistyped, is a file; no name is too long to ask."""
    try:
        return path.is_file()
    except OSError:
        return False


def read_small_text(path: Path, most_bytes: int) -> str:
    """The text of a file that somebody else may have put there; what is not UTF-8 is marked.

    Raises ``ValueError`` if it is no regular file (a pipe would never end) of at most
    ``most_bytes``.
    """
    if not path.is_file():
        msg = "missing, or not a file"
        raise ValueError(msg)
    if path.stat().st_size > most_bytes:
        msg = f"larger than {most_bytes} bytes"
        raise ValueError(msg)
    return path.read_text(encoding="utf-8", errors="replace")


def sha256_of(path: Path) -> str:
    """Hex digest of the file's bytes."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def sha256_of_content(content: object) -> str:
    """Hex digest of plain data, the same for what means the same, however it is written."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
