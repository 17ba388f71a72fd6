"""numba's compiler, and a folder for what it has compiled where it would find none."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from tacgen.core.progress import LOG


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _find_folder() -> str:
    """The temporary folder that numba compiles to; empty where it has a lasting one.

    Where numba can write neither beside the package nor into the user's cache, as in a container
    with a read-only package and no home, it would refuse to compile.
    """
    if os.environ.get("NUMBA_CACHE_DIR"):
        return ""
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    beside = Path(__file__).parents[1] / "__pycache__"
    if _can_write(beside) or _can_write(Path(cache) / "numba"):
        return ""
    folder = tempfile.mkdtemp(prefix="tacgen-compiled-")
    os.environ["NUMBA_CACHE_DIR"] = folder  # for processes that this one starts, too
    atexit.register(_remove, folder, os.getpid())
    LOG.warning(
        "nothing that is compiled can be kept (%s and %s cannot be written), so each start takes "
        "some 20 s longer; set NUMBA_CACHE_DIR to a folder that can",
        beside.parent,
        cache,
    )
    return folder


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:  # not a copy of it
        shutil.rmtree(folder, ignore_errors=True)


TEMPORARY_FOLDER = _find_folder()

from numba import njit  # noqa: E402

__all__ = ["TEMPORARY_FOLDER", "njit"]
