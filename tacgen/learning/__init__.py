"""Grasp-stability networks: trained on simulated grasps, tested on those and real ones."""

from tacgen.core.errors import LearningError, require_extra


def require_learning_extra() -> None:
    """Check that the libraries for learning are installed.

    Raises ``LearningError``, which names every missing library and the command that installs them.
    """
    require_extra("learn", "training and evaluation need", LearningError)
