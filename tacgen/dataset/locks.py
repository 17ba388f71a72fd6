"""Locks of the operating system, which frees those of a process that dies."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import time
from pathlib import Path

_LOCK_TRIES, _LOCK_PAUSE_S = 75, 0.02
_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


def open_locked(path: Path) -> tuple[int, bool | None]:
    """Open and lock ``path``; (descriptor, True), or False where another holds it.

    None instead of True where this file system has no locks.
    """
    tries = _LOCK_TRIES
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        held = lock(descriptor)
        tries -= 1
        if held is False and tries:
            # It may be `running`, looking whether a lock is held, which lasts an instant, or a
            # worker of a run that was killed, which ends within a second on a busy machine.
            os.close(descriptor)
            time.sleep(_LOCK_PAUSE_S)
            continue
        # The holder removes the file when it is through: a lock on a removed file is no lock.
        if not held or _is_same_file(descriptor, path):
            return descriptor, held
        os.close(descriptor)


def lock(descriptor: int) -> bool | None:
    """Try to lock an open file: False where another holds it, None where there are no locks."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return None if error.errno in _NO_LOCKS_HERE else False
    return True


def _is_same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def write_holder(descriptor: int) -> None:
    """Note in a lock file whose it is."""
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
