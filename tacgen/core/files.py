"""Files that appear whole or not at all, and hashes of what is on disk."""

import contextlib
import hashlib
import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacgen.core.errors import TacgenError


@contextlib.contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside ``path``; renamed to it on success, removed on failure.

    The content is flushed to disk before the rename, so that after a power loss ``path`` is
    either the old file or the whole new one.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Host and process: two machines that share the folder may share process numbers.
    partial = path.with_name(f".{path.name}.{socket.gethostname()}.{os.getpid()}.part")
    try:
        yield partial
        sync_file(partial)
        os.replace(partial, path)
        sync_file(path.parent)
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder beside ``path``; renamed to it on success, removed on failure.

    Raises ``TacgenError`` if ``path`` exists already.
    """
    path = Path(path)
    if path.exists():
        msg = f"{path} exists already; give a new folder, or remove it"
        raise TacgenError(msg)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
    try:
        partial.chmod(0o755)
        yield partial
        for file in partial.rglob("*"):
            sync_file(file)
        os.replace(partial, path)
        sync_file(path.parent)
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
