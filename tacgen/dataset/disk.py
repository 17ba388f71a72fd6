"""Disks that are full, read-only or gone: one plain message, and HDF5 kept out of it."""

import contextlib
import errno
import io
from collections.abc import Iterator
from pathlib import Path

from tacgen.core.errors import DatasetError

_FIXES = {
    errno.ENOSPC: "free some space and run the same command again; finished shards are kept",
    errno.EDQUOT: "your quota is used up; free some and run the same command again",
    errno.EISDIR: "remove it and run the same command again",
}
_FIXES |= dict.fromkeys(
    (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOTDIR), "give a folder that you may write to"
)


@contextlib.contextmanager
def disk_errors(root: Path) -> Iterator[None]:
    """Turn what the operating system says about a disk into one ``DatasetError`` with the fix."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        fix = _FIXES.get(error.errno, "finished shards are kept; run the same command again")
        what = error.strerror or str(error)
        in_the_way = error.errno == errno.EISDIR
        where = (in_the_way and (error.filename2 or error.filename)) or root
        msg = f"{where}: {what[:1].lower()}{what[1:]}; {fix}"
        raise DatasetError(msg) from error


class DiskFile(io.FileIO):
    """A file for HDF5 to write to, which keeps the disk's errors to itself.

    HDF5 cannot close a file whose last bytes do not fit on the disk: it holds on to it and to the
    space. So a failed write only sets ``failure``, later ones do nothing, and whoever writes
    calls ``raise_failure`` when it suits.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self.failure: OSError | None = None

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
        """Raise the first error there was, if any."""
        if self.failure is not None:
            raise self.failure
