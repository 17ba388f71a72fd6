"""A grasp depends on its own configuration and on nothing that came before."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from tacgen.physics import FrameRequest, GraspSimulator
from tacgen.physics.settings import EngineName

from .conftest import SEQUENCE, block, dumbbell, grasp, opened


def as_bytes(value: object) -> bytes:
    """Every number of a record, to the last bit."""
    if is_dataclass(value):
        return b"|".join(as_bytes(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, tuple):
        return b",".join(as_bytes(item) for item in value)
    if isinstance(value, dict):
        return b";".join(key.encode() + as_bytes(item) for key, item in value.items())
    if isinstance(value, float):
        return np.float64(value).tobytes()
    return repr(value).encode()


class TestRepeatability:
    @pytest.mark.slow
    def test_a_grasp_does_not_remember_those_before_it(self, engine: EngineName) -> None:
        asked = [
            (block(), 8.0, FrameRequest()),
            (dumbbell(), 12.0, SEQUENCE),
            (block(center_of_mass_offset_mm=(0, 20, 0)), 10.0, FrameRequest()),
            (block(size_mm=(150, 60, 100)), 10.0, FrameRequest()),
            (block(), 2.0, SEQUENCE),
        ]

        def trace(simulator: GraspSimulator, k: int) -> bytes:
            obj, force_n, frames = asked[k]
            return as_bytes(
                grasp(simulator, obj, force_n=force_n, x_mm=2.0, z_mm=30.0, frames=frames)
            )

        fresh = []
        for k in range(len(asked)):
            with opened("wsg50", engine) as simulator:
                fresh.append(trace(simulator, k))
        with opened("wsg50", engine) as simulator:
            for k in (4, 0, 3, 1, 2, 0, 4, 2, 1):
                assert trace(simulator, k) == fresh[k], f"grasp {k} differs"

    def test_two_simulators_do_not_disturb_each_other(self, engine: EngineName) -> None:
        with opened("wsg50", engine) as first:
            alone = as_bytes(grasp(first, block()))
            with opened("ur5e_wsg50", engine) as second:
                grasp(second, block(), force_n=3.0)
                assert as_bytes(grasp(first, block())) == alone
