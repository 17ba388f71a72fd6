"""The referee's cases: balls pressed on the gel block, sheared, there and back, and turned."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from tacgen.contact.shear import marker_grid_mm
from tacgen.core.sensors import load_sensor
from validation.shear.ball import BallContact, BallPose, Touch
from validation.shear.gel_block import Float64, GelBlock, Surface

RADII_MM, DEPTHS_MM, SHARES = (2.0, 4.0, 8.0), (0.3, 0.6, 1.0), (0.3, 0.7, 1.0)
FRICTION = 0.6
DIRECTION = np.array([0.8, 0.6])
THIN_MM = 2.5
PRESS_STEPS, SHEAR_STEPS = 10, 12
REACH_MM = {2.0: 1.95, 4.0: 3.6, 8.0: 4.2}
GRID_MM = np.stack(
    np.meshgrid(np.arange(-18, 19) * 0.5, np.arange(-14, 15) * 0.5), axis=-1
)  # (29, 37, 2): rows along y


@dataclass(frozen=True)
class Case:
    """One ball at one depth on one gel; ``path`` is what it does after the press.

    A stop of the path is ("shear", share of μF_n along DIRECTION) or ("turn", share of the most
    torque), each from the state before.
    """

    radius_mm: float
    depth_mm: float
    path: tuple[tuple[str, float], ...]
    name: str
    thickness_mm: float = 4.0


@dataclass(frozen=True)
class State:
    """What the referee knows of one state of a case; forces on the gel, about the middle."""

    case: Case
    stop: str
    touch: Touch
    normal_n: float
    shear_n: Float64
    torque_n_mm: float
    contact_radius_mm: float
    volume_mm3: float
    """What the ball's part that touches displaces: the sum of -u_z over it."""
    surface: Surface
    points_mm: Float64
    area_mm2: Float64
    slipping: Float64

    @property
    def title(self) -> str:
        """One line for tables."""
        return f"{self.case.name} {self.stop}"


def cases(quick: bool = False) -> list[Case]:
    """All cases; with ``quick`` one depth of each ball on the thick gel."""
    shares = tuple(("shear", share) for share in SHARES)
    found = [
        Case(radius, depth, shares, f"r{radius:.0f} d{depth}")
        for radius in RADII_MM
        for depth in (DEPTHS_MM[1:2] if quick else DEPTHS_MM)
    ]
    back = tuple(("shear", share) for share in (0.7, 0.0, -0.7, 0.0, 0.7))
    turns = (("turn", 0.5), ("turn", 0.9))
    both = (("shear", 0.5), ("turn", 0.4))
    for radius in RADII_MM:
        middle = Case(radius, DEPTHS_MM[1], back, f"r{radius:.0f} d{DEPTHS_MM[1]} cycle")
        found.append(middle)
        found.append(replace(middle, path=turns, name=f"r{radius:.0f} d{DEPTHS_MM[1]} twist"))
        found.append(replace(middle, path=both, name=f"r{radius:.0f} d{DEPTHS_MM[1]} both"))
    if not quick:
        found += [
            Case(radius, depth, shares, f"r{radius:.0f} d{depth} thin", THIN_MM)
            for radius in RADII_MM
            for depth in DEPTHS_MM[:2]
        ]
    return found


@cache
def block(thickness_mm: float, fine_mm: float = 0.15) -> GelBlock:
    """The gel of that thickness, made once."""
    return GelBlock(thickness_mm=thickness_mm, fine_mm=fine_mm)


@cache
def contact(radius_mm: float, thickness_mm: float, fine_mm: float = 0.15) -> BallContact:
    """The ball on that gel, made once."""
    gel = block(thickness_mm, fine_mm)
    return BallContact(gel, radius_mm, FRICTION, REACH_MM[radius_mm])


def solved(case: Case, fine_mm: float = 0.15) -> Iterator[State]:
    """The states at the end of the press and at each stop of its path."""
    ball = contact(case.radius_mm, case.thickness_mm, fine_mm)
    touch = ball.to(ball.start(), BallPose(case.depth_mm), PRESS_STEPS)
    yield _state(case, "press", ball, touch)
    for k, (kind, share) in enumerate(case.path):
        if kind == "shear":
            touch = ball.sheared_to(touch, DIRECTION, share, SHEAR_STEPS)
        else:
            touch = ball.turned_to(touch, share, SHEAR_STEPS)
        yield _state(case, f"{k + 1}: {kind} {share:g}", ball, touch)


def _state(case: Case, stop: str, ball: BallContact, touch: Touch) -> State:
    touching = touch.force_n[:, 2] < 0
    return State(
        case=case,
        stop=stop,
        touch=touch,
        normal_n=ball.normal_n(touch),
        shear_n=ball.shear_n(touch),
        torque_n_mm=ball.torque_n_mm(touch),
        contact_radius_mm=ball.contact_radius_mm(touch),
        volume_mm3=float(-(ball.area_mm2 * touch.motion_mm[:, 2])[touching].sum()),
        surface=ball.block.surface(ball.index, ball.sides, touch.force_n),
        points_mm=ball.points_mm,
        area_mm2=ball.area_mm2,
        slipping=ball.slipping(touch),
    )


def say(line: str) -> None:
    """Print a line."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def mini_markers_mm() -> Float64:
    """The rest positions (63, 2) of a GelSight Mini's markers."""
    return marker_grid_mm(load_sensor("gelsight_mini"))
