"""The libraries of the extra ``tacgen[learn]``, and a plain word where they are missing."""

from __future__ import annotations

from importlib import metadata
from importlib.util import find_spec

import tacgen
from tacgen.core.errors import LearningError

LIBRARIES = ("torch", "transformers", "safetensors", "sklearn", "tensorboard")
MEND = "install them with `pip install 'tacgen[learn]'` (in a checkout: `make setup`)"


def require_learning_extra() -> None:
    """Check that the libraries for learning can be imported.

    Raises
    ------
    LearningError
        Names every missing library and the command that installs them.
    """
    missing = [name for name in LIBRARIES if find_spec(name) is None]
    if missing:
        msg = f"training and evaluation need {', '.join(missing)}, not installed here; {MEND}"
        raise LearningError(msg)


def library_versions() -> dict[str, str]:
    """Versions of what the weights depend on."""
    versions = {"tacgen": tacgen.__version__}
    for name in ("torch", "torchvision", "transformers", "numpy", "opencv-python-headless"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions
