"""Checks of this machine, and how to install what is missing."""

import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from tacgen.core.errors import PhysicsError
from tacgen.physics.settings import engine_of

MIN_FREE_GB = 2.0  # some 3000 grasps of eight frames of 320×240 px, at 80 kB a compressed frame
GL_PROBE_TIMEOUT_S = 60.0
"""A software renderer on a loaded machine responds within ten seconds; drivers may hang."""


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check; ``needed``: nothing can be collected without it."""

    name: str
    ok: bool
    needed: bool
    detail: str
    fix: str = ""

    def __str__(self) -> str:
        mark = "ok" if self.ok else "MISSING" if self.needed else "none"
        fix = f"  → {self.fix}" if self.fix else ""
        return f"{mark:>7}  {self.name:<10} {self.detail}{fix}"


def examine(folder: Path = Path()) -> list[Finding]:
    """Check this machine; ``folder`` is where datasets would go."""
    return [
        _python(),
        _engine(),
        _pybullet(),
        _gl_platform("EGL", "egl", "a GPU driver with libEGL (Debian: libegl1)"),
        _gl_platform("OSMesa", "osmesa", "Debian: libosmesa6, and PyOpenGL 3.1.4 or newer"),
        _compiled(),
        _cores(),
        _disk(folder),
        _extra("torch", "learn", "networks"),
        _extra("submitit", "cluster", "batch jobs"),
    ]


def _python() -> Finding:
    ok = sys.version_info[:2] >= (3, 11)
    fix = "" if ok else "tacgen needs Python 3.11 or newer"
    return Finding("python", ok, True, ".".join(map(str, sys.version_info[:3])), fix)


def _pybullet() -> Finding:
    from tacgen.physics.pybullet_import import load_bullet

    try:
        load_bullet()
    except PhysicsError as error:
        problem, _, fix = str(error).partition("; ")
        return Finding("pybullet", False, False, problem, fix)
    return Finding("pybullet", True, False, f"{importlib.metadata.version('pybullet')}, with numpy")


def _engine() -> Finding:
    """What simulates recipes that name no engine."""
    name = engine_of("auto")
    if importlib.util.find_spec(name) is None:
        return Finding("engine", False, True, "no MuJoCo and no PyBullet", "`pip install mujoco`")
    detail = f"{name} {importlib.metadata.version(name)}, in recipes that name none"
    return Finding("engine", True, True, detail)


def _gl_platform(name: str, platform: str, fix: str) -> Finding:
    """Whether pyrender can open a context; tried in a process of its own, as GL may abort it."""
    code = "import pyrender; pyrender.OffscreenRenderer(8, 8).delete()"
    fix += "; only needed for camera: pyrender"
    environment = os.environ | {"PYOPENGL_PLATFORM": platform}
    command, limit_s = [sys.executable, "-c", code], GL_PROBE_TIMEOUT_S
    try:
        subprocess.run(command, env=environment, capture_output=True, timeout=limit_s, check=True)
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
        return Finding(name, False, False, "not available", fix)
    return Finding(name, True, False, "works")


def _compiled() -> Finding:
    from tacgen.core.caches import TEMPORARY_FOLDER
    from tacgen.core.compiled import KEEPS_NOTHING

    lost = ["NUMBA_CACHE_DIR"] if KEEPS_NOTHING else []
    if TEMPORARY_FOLDER and "WARP_CACHE_PATH" not in os.environ:
        lost += ["WARP_CACHE_PATH"] if importlib.util.find_spec("warp") else []
    if not lost:
        return Finding("compiled", True, False, "kept from run to run")
    fix = f"set {' and '.join(lost)} to a folder that can be written"
    return Finding("compiled", False, False, "kept for one command only", fix)


def _cores() -> Finding:
    cores = len(os.sched_getaffinity(0))
    return Finding("cores", True, False, f"{cores}, all used unless --workers says otherwise")


def _disk(folder: Path) -> Finding:
    free_gb = shutil.disk_usage(folder).free / 1e9
    ok = free_gb >= MIN_FREE_GB
    fix = "" if ok else f"free some space or write elsewhere; datasets need {MIN_FREE_GB:g} GB"
    return Finding("free disk", ok, True, f"{free_gb:.1f} GB in {folder.resolve()}", fix)


def _extra(package: str, extra: str, purpose: str) -> Finding:
    ok = importlib.util.find_spec(package) is not None
    detail = importlib.metadata.version(package) if ok else "not installed"
    fix = "" if ok else f"`pip install 'tacgen[{extra}]'`; only needed for {purpose}"
    return Finding(package, ok, False, detail, fix)
