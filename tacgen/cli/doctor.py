"""What this machine can do for tacgen, and how to mend what is missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacgen.core.errors import PhysicsError

MIN_FREE_GB = 2.0
GL_PROBE_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing looked at: ``needed`` says whether tacgen's default path depends on it."""

    name: str
    ok: bool
    needed: bool
    detail: str
    mend: str = ""


def examine(folder: Path = Path()) -> list[Finding]:
    """Look at this machine; ``folder`` is where datasets would go."""
    checks: tuple[Callable[[], Finding], ...] = (
        _python,
        _numpy_in_pybullet,
        _egl,
        _osmesa,
        _cores,
        lambda: _disk(folder),
        _learning,
        _submitit,
    )
    return [check() for check in checks]


def _python() -> Finding:
    version = ".".join(str(part) for part in sys.version_info[:3])
    ok = (3, 10) <= sys.version_info[:2] <= (3, 11)
    return Finding(
        "python",
        ok,
        needed=False,
        detail=version,
        mend="" if ok else "PyBullet ships wheels for 3.10 and 3.11; others build it from source",
    )


def _numpy_in_pybullet() -> Finding:
    from tacgen.physics.world import load_bullet

    try:
        load_bullet()
    except PhysicsError as error:
        problem, _, mend = str(error).partition("; ")
        return Finding("pybullet", False, True, problem, mend)
    version = importlib.metadata.version("pybullet")
    return Finding("pybullet", True, True, f"{version}, with numpy")


def _egl() -> Finding:
    return _gl_platform(
        "EGL", "egl", "a GPU driver with libEGL (Debian: libegl1); only needed for camera: pyrender"
    )


def _osmesa() -> Finding:
    return _gl_platform(
        "OSMesa",
        "osmesa",
        "Debian: libosmesa6, and PyOpenGL 3.1.4 or newer; only needed for camera: pyrender",
    )


def _gl_platform(name: str, platform: str, mend: str) -> Finding:
    """Whether pyrender can open a context; tried in a process of its own, as GL may abort it."""
    code = "import pyrender; pyrender.OffscreenRenderer(8, 8).delete()"
    environment = os.environ | {"PYOPENGL_PLATFORM": platform}
    try:
        result = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            timeout=GL_PROBE_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Finding(name, False, False, "did not answer", mend)
    ok = result.returncode == 0
    return Finding(name, ok, False, "works" if ok else "not available", "" if ok else mend)


def _cores() -> Finding:
    cores = len(os.sched_getaffinity(0))
    return Finding("cores", True, False, f"{cores}; `--workers {cores}` uses them all")


def _disk(folder: Path) -> Finding:
    free_gb = shutil.disk_usage(folder).free / 1e9
    ok = free_gb >= MIN_FREE_GB
    mend = "" if ok else f"free some space or write elsewhere; datasets want {MIN_FREE_GB:g} GB"
    return Finding("free disk", ok, True, f"{free_gb:.1f} GB in {folder.resolve()}", mend)


def _learning() -> Finding:
    return _extra("torch", "learn", "networks")


def _submitit() -> Finding:
    return _extra("submitit", "cluster", "batch jobs")


def _extra(package: str, extra: str, purpose: str) -> Finding:
    ok = importlib.util.find_spec(package) is not None
    detail = importlib.metadata.version(package) if ok else "not installed"
    mend = "" if ok else f"`pip install 'tacgen[{extra}]'`; only needed for {purpose}"
    return Finding(package, ok, False, detail, mend)
