"""PyBullet, where it can be imported."""

import contextlib
import os
from collections.abc import Iterator
from types import ModuleType

from tacgen.core.errors import PhysicsError


def load_bullet() -> ModuleType:
    """PyBullet, checked to exchange arrays with numpy.

    Raises ``PhysicsError`` if PyBullet is missing, or was built without numpy.
    """
    try:
        with _quiet_standard_error():
            import pybullet
    except ImportError as error:
        msg = (
            f"PyBullet cannot be imported ({error}); install it with `pip install pybullet` under "
            "Python 3.11, the last with wheels of it, or simulate in MuJoCo: "
            "`physics: {engine: mujoco}`"
        )
        raise PhysicsError(msg) from error
    return require_numpy(pybullet)


@contextlib.contextmanager
def _quiet_standard_error() -> Iterator[None]:
    """Keep PyBullet from writing when it was built on standard error as it is imported."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def require_numpy(bullet: ModuleType) -> ModuleType:
    """``bullet`` itself; raises ``PhysicsError`` if it was built without numpy."""
    if not bullet.isNumpyEnabled():
        msg = (
            "PyBullet was built without numpy (pybullet.isNumpyEnabled() is 0); with numpy "
            "installed, run `pip install --force-reinstall --no-cache-dir pybullet` under "
            "Python 3.11, the last with wheels that have it"
        )
        raise PhysicsError(msg)
    return bullet
