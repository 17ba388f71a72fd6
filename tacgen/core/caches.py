"""A folder for what libraries keep between runs, where the user's own cannot be written."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path


def can_write(folder: Path) -> bool:
    """Whether a file can be written into ``folder``, which is made if it is not there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _find_folder() -> str:
    """The temporary folder of caches; empty where the user's can be written.

    In a container without a home that can be written, numba and Warp would refuse to compile, and
    Matplotlib and fontconfig complain. What the user's cache holds of models stays there to read.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if can_write(cache):
        return ""
    folder = tempfile.mkdtemp(prefix="tacgen-cache-")
    os.environ["XDG_CACHE_HOME"] = folder  # for processes that this one starts, too
    kept = {"HF_HOME": cache / "huggingface", "TORCH_HOME": cache / "torch"}
    for name, path in ({"MPLCONFIGDIR": f"{folder}/matplotlib"} | kept).items():
        os.environ.setdefault(name, str(path))
    atexit.register(_remove, folder, os.getpid())
    return folder


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:  # not a copy of it
        shutil.rmtree(folder, ignore_errors=True)


TEMPORARY_FOLDER = _find_folder()
