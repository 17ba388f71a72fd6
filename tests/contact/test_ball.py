"""A ball in the gel has the volume of its cap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.contact.ball import GelLattice
from tests.marker_sessions import SENSOR

FLAT = replace(SENSOR, dome_radius_mm=0.0)


@pytest.mark.parametrize("every", [1, 4])
def test_the_depth_is_that_of_the_cap_of_the_volume(every):
    radius_mm, depth_mm = 4.0, 0.6
    volume_mm3 = np.pi * depth_mm**2 * (radius_mm - depth_mm / 3.0)
    gel = GelLattice.of(FLAT, every)
    found = gel.ball_depth_mm(radius_mm, (1.0, -0.5), volume_mm3)
    assert found.sum() * gel.cell_mm2 == pytest.approx(volume_mm3, rel=1e-6)
    assert found.max() == pytest.approx(depth_mm, rel=0.01)
    away = np.hypot(gel.x_mm - 1.0, gel.y_mm[:, None] + 0.5)
    rim_mm = np.sqrt(depth_mm * (2.0 * radius_mm - depth_mm))
    assert away[found > 0].max() == pytest.approx(rim_mm, abs=np.sqrt(gel.cell_mm2))


def test_a_ball_beside_the_gel_or_without_a_volume_touches_nothing():
    gel = GelLattice.of(FLAT)
    assert not gel.ball_depth_mm(4.0, (100.0, 0.0), 3.0).any()
    assert not gel.ball_depth_mm(4.0, (0.0, 0.0), 0.0).any()
