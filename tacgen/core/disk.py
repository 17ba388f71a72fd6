"""Disks that are full, read-only or gone: one plain message, and libraries kept out of it."""

import contextlib
import errno
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from tacgen.core.errors import DatasetError, Interrupted

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
