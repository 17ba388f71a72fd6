"""Files that appear whole or not at all, and hashes of what is on disk."""

import contextlib
import errno
import fcntl
import functools
import glob
import hashlib
import io
import itertools
import json
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self

from tacgen.core.errors import DatasetError, Interrupted, TacgenError

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
def atomic_folder(path: Path, *, replaces: bool = False) -> Iterator[Path]:
    """Yield an empty folder of the name of ``path``; moved there on success, removed on failure.

    What a killed process left of the same ``path`` is removed too. Raises ``TacgenError`` if
    ``path`` exists already, unless it ``replaces`` that, or another process is writing it.
    """
    path = Path(path)
    if os.path.lexists(path) and not replaces:
        msg = f"{path} exists already; give a new folder, or remove it"
        raise TacgenError(msg)
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.with_name(f".{path.name}.lock")
    with alone(lock, path, "writing it", TacgenError) as held:
        if held:
            for left in path.parent.glob(f".{glob.escape(path.name)}.????????.part"):
                shutil.rmtree(left, ignore_errors=True)
        work = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
        partial = work / path.name
        try:
            partial.mkdir(mode=0o755)
            yield partial
            for file in (partial, *partial.rglob("*")):
                sync_file(file)
            if replaces and os.path.lexists(path):
                os.replace(path, work / "replaced")
            os.replace(partial, path)
            sync_file(path.parent)
        except OSError as error:
            error.filename = error.filename or str(path)
            raise
        finally:
            shutil.rmtree(work, ignore_errors=True)


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


_WAIT = "wait for it, or end it"
_LOCK_TRIES, _LOCK_PAUSE_S = 75, 0.02
_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[bool | None]:
    """Hold the lock file ``path`` until the block ends, then remove it.

    Yields True, False where another process holds it, or None where this file system has no
    locks. The file names its holder.

    Raises ``TacgenError`` if ``path`` is a symbolic link.
    """
    descriptor, held = open_locked(path)
    try:
        if held is not False:
            _write_holder(descriptor, path)
        yield held
    finally:
        if held is not False:
            path.unlink(missing_ok=True)
        os.close(descriptor)


@contextlib.contextmanager
def alone(
    path: Path, where: Path, doing: str, error: type[TacgenError], fix: str = _WAIT
) -> Iterator[bool | None]:
    """Hold the lock file ``path`` as ``locked`` does.

    Raises ``error`` where another process holds it, which says what that is ``doing``, and where.
    """
    with locked(path) as held:
        if held is False:
            msg = f"{where}: {holder_of(path) or 'another process'} is {doing}; {fix}"
            raise error(msg)
        yield held


def _write_holder(descriptor: int, path: Path) -> None:
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    except OSError as error:
        error.filename = str(path)
        raise


def holder_of(path: Path) -> str | None:
    """The process that holds the lock file ``path`` now, if any."""
    if path.is_symlink() or not path.is_file():
        return None
    # Shared and for reading, as whoever may not write to it can ask.
    with contextlib.suppress(FileNotFoundError), path.open(errors="replace") as file:
        if _lock(file.fileno(), fcntl.LOCK_SH) is False:
            return file.read(200).strip() or "another process"
    return None


def open_locked(path: Path) -> tuple[int, bool | None]:
    """Open and lock ``path``; (descriptor, True), or False where another holds it.

    None instead of True where this file system has no locks.

    Raises ``TacgenError`` if ``path`` is a symbolic link.
    """
    for left in itertools.count(_LOCK_TRIES - 1, -1):
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        except OSError as error:
            if error.errno != errno.ELOOP:
                raise
            msg = f"{path}: is a symbolic link where a lock file should be; remove it"
            raise TacgenError(msg) from error
        held = _lock(descriptor)
        if held is False and left > 0:
            # It may be `holder_of`, checking whether a lock is held, which lasts an instant, or a
            # worker of a run that was killed, which ends within a second on a busy machine.
            time.sleep(_LOCK_PAUSE_S)
        # The holder removes the file when it is through: a lock on a removed file is no lock.
        elif not held or _is_same_file(descriptor, path):
            break
        os.close(descriptor)
    return descriptor, held


def _lock(descriptor: int, kind: int = fcntl.LOCK_EX) -> bool | None:
    """Try to lock an open file: False where another holds it, None where there are no locks."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except OSError as error:
        return None if error.errno in _NO_LOCKS_HERE else False
    return True


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


_AGAIN = "run the same command again"
_FIXES = {
    errno.ENOSPC: f"free some space and {_AGAIN}",
    errno.EDQUOT: f"your quota is used up; free some and {_AGAIN}",
    errno.EFBIG: f"raise the limit of a file's size (`ulimit -f`) and {_AGAIN}",
    errno.EISDIR: f"remove it and {_AGAIN}",
}
_UNWRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR)


def disk_message(error: OSError, where: Path | str, otherwise: str) -> str:
    """What the operating system says about ``where``, and the fix, which may be ``otherwise``."""
    link = error.filename
    if error.errno == errno.EEXIST and link and os.path.islink(link) and not os.path.exists(link):
        target = os.readlink(link)
        return f"{link}: is a link to {target}, which is not there; make it, or remove the link"
    what = os.strerror(error.errno) if error.errno else str(error)
    fix = _FIXES.get(error.errno or 0, otherwise)
    return f"{where}: {what[:1].lower()}{what[1:]}; {fix}" if where else f"{what}; {fix}"


@contextlib.contextmanager
def disk_errors(root: Path, kept: str = "") -> Iterator[None]:
    """Turn what the operating system says about a disk into one ``DatasetError`` with the fix.

    ``kept`` is what of the work is not lost.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        fix = "give a folder that you may write to" if error.errno in _UNWRITABLE else _AGAIN
        in_the_way = error.errno == errno.EISDIR
        where = (in_the_way and (error.filename2 or error.filename)) or root
        msg = disk_message(error, where, fix) + (f"; {kept}" if kept else "")
        raise DatasetError(msg) from error


class DiskFile(io.FileIO):
    """A file for a library to write to, which keeps the disk's errors to itself.

    HDF5 cannot close a file whose last bytes do not fit on the disk: it holds on to it and to the
    space, or ends the process. Others lose the reason. So a failed write only sets ``failure``,
    later ones do nothing, and whoever writes calls ``raise_failure`` when it suits. An interruption
    waits for that too: raised amid a write, it can end the process in HDF5's own code.
    """

    _n_open = 0
    _interrupted = False

    @classmethod
    def holds_interruptions(cls) -> bool:
        """Whether a file is being written, so that an interruption that has just come waits."""
        DiskFile._interrupted = DiskFile._n_open > 0
        return DiskFile._interrupted

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.failure: OSError | None = None

    def __enter__(self) -> Self:
        """Interruptions wait from here on."""
        DiskFile._n_open += 1
        return super().__enter__()

    def __exit__(self, kind: type[BaseException] | None, *about: Any) -> None:
        """Close it; an interruption that waited is raised, unless another error is on its way."""
        super().__exit__(kind, *about)
        DiskFile._n_open -= 1
        waited, DiskFile._interrupted = DiskFile._interrupted, False
        if waited and kind is None:
            raise Interrupted

    def write(self, data: object) -> int:
        """Write all of ``data``, or remember why not."""
        view = memoryview(data)  # type: ignore[arg-type]
        done = 0
        while self.failure is None and done < len(view):
            try:
                done += super().write(view[done:]) or 0
            except OSError as error:
                self.failure = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length, or remember why not."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0

    def raise_failure(self) -> None:
        """Raise the first error there was, if any, or an interruption that waited."""
        if self.failure is not None:
            raise self.failure
        if DiskFile._interrupted:
            DiskFile._interrupted = False
            raise Interrupted
