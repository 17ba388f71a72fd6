"""Shards have the same bytes whichever variants of its kernels a library would choose."""

import json
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from typing import get_args

import pytest

from tacgen.physics.settings import EngineName
from tests.small_world import write_world

from .conftest import digests

CORES = ("Prescott", "Sandybridge", "Haswell", "SkylakeX")  # Zen has the kernels of Haswell
VARIANTS = {f"OpenBLAS for {name}": {"OPENBLAS_CORETYPE": name} for name in CORES} | {
    "C library without FMA": {
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable,-FMA4"
    },
    "numpy without AVX2": {"NPY_DISABLE_CPU_FEATURES": "X86_V3 AVX2 FMA3"},
    "numba for any processor": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
}
# Inverse kinematics, turned rotations, marker motion and shear reach every BLAS and libm call.
RECIPE = """
name: processors
seed: 3
objects: [tomato_soup_can]
sensor: coarse
grid: {force_n: {geomspace: [3, 15, 2]}, y_mm: [4], z_mm: [30], yaw_rad: [0.3]}
frames: {mode: sequence, count: 3}
robot: {name: ur5e_wsg50, tactile_pads: both}
optics: {shadows: true, markers: true, noise: true}
dataset: {depth: all, markers: true, force_field: [4, 5]}
scene: {frames: all, cameras: [{name: a, look_at: {from_mm: [300, -280, 200], to_mm: [3, 5, 70]}}]}
randomize: {friction_relative: 0.1, center_of_mass_mm: 1.0, position_mm: 0.5, yaw_rad: 0.02}
"""


@pytest.fixture(scope="module", params=get_args(EngineName))
def engine(request):
    return request.param


def collected(folder, engine, variables):
    (folder / "processors.yaml").write_text(f"{RECIPE}physics: {{engine: {engine}}}\n")
    command = [sys.executable, "-m", "tacgen", "collect", "processors.yaml", "--out", "data"]
    run = subprocess.run(
        command, cwd=folder, env=os.environ | variables, capture_output=True, timeout=300
    )
    if run.returncode == -signal.SIGILL:
        pytest.skip(f"this processor cannot run {variables}")
    assert run.returncode == 0, run.stderr.decode()
    return digests(folder / "data")


@pytest.fixture(scope="module")
def usual(engine, tmp_path_factory):
    folder = tmp_path_factory.mktemp("usual")
    write_world(folder)
    return collected(folder, engine, {})


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_bytes_are_the_same(world, tmp_path, engine, usual, variant):
    assert collected(tmp_path, engine, VARIANTS[variant]) == usual


def numbers(value, name=""):
    """Every number of a JSON document by its place; everything else as it is."""
    if isinstance(value, dict):
        return {k: v for key in value for k, v in numbers(value[key], f"{name}/{key}").items()}
    if isinstance(value, list):
        return {k: v for i, one in enumerate(value) for k, v in numbers(one, f"{name}/{i}").items()}
    return {name: value}


@pytest.mark.slow
def test_a_diagnosis_has_the_same_names_and_figures(tmp_path):
    """Beside shards, which are equal, figures may differ by rounding alone."""
    tacgen = [sys.executable, "-m", "tacgen"]
    run = partial(subprocess.run, cwd=tmp_path, check=True, capture_output=True, timeout=300)
    run([*tacgen, "rig", "rig_creep", "--out", "rig"])
    found = []
    for variables in ({}, VARIANTS["OpenBLAS for Prescott"] | VARIANTS["C library without FMA"]):
        command = [*tacgen, "diagnose", "contact", "rig/press_log.csv", "--out", "found", "--json"]
        found.append(numbers(json.loads(run(command, env=os.environ | variables).stdout)))
        shutil.rmtree(tmp_path / "found")
    usual, other = found
    assert usual["/channels/normal/verdict"] == "effect_found"
    assert other == {
        name: pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value
        for name, value in usual.items()
    }
