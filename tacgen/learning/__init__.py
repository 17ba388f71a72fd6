"""Grasp-stability networks: trained on simulated grasps, tested on those and real ones."""

from importlib.util import find_spec

from tacgen.core.errors import LearningError

_LIBRARIES = ("torch", "transformers", "safetensors", "sklearn", "tensorboard")


def require_learning_extra() -> None:
    """Check that the libraries for learning are installed.

    Raises ``LearningError``, which names every missing library and the command that installs them.
    """
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        msg = (
            f"training and evaluation need {', '.join(missing)}, not installed here; install them "
            "with `pip install 'tacgen[learn]'` (in a checkout: `make setup`)"
        )
        raise LearningError(msg)
