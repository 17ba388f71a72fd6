"""Lock files, by locks of the operating system: it frees those of a process that dies."""

import contextlib
import errno
import fcntl
import itertools
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from tacgen.core.errors import TacgenError

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
