"""The lift's profile."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def trapezoid(
    distance: float, speed: float, acceleration: float, time_step_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Positions and speeds at the end of each step of a motion over ``distance``, rest to rest.

    The speed rises and falls by ``acceleration`` and stays at ``speed`` between; where the
    distance is too short for that speed, it turns round halfway.
    """
    speed = min(speed, float(np.sqrt(distance * acceleration)))
    ramp_s = speed / acceleration
    total_s = distance / speed + ramp_s
    count = int(np.ceil(total_s / time_step_s - 1e-9))
    time_s = np.arange(count + 1) * time_step_s
    rising = np.minimum(time_s, ramp_s)
    falling = np.clip(time_s - (total_s - ramp_s), 0.0, ramp_s)
    cruise = np.clip(time_s - ramp_s, 0.0, total_s - 2 * ramp_s)
    positions = (
        acceleration * rising**2 / 2
        + speed * cruise
        + speed * falling
        - acceleration * falling**2 / 2
    )
    return positions[1:], np.diff(positions) / time_step_s
