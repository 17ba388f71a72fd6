"""The referee against closed forms: run it with ``python -m validation.shear.checks``.

A ball pressed on a layer that is bonded to its base (Hertz 1882; for its thickness Dimitriadis et
al. 2002, Biophys. J. 82, Eq. 12), then sheared (Cattaneo 1938, Mindlin 1949) and turned; and the
gel's own mesh refined.
"""

from dataclasses import dataclass

import numpy as np

from validation.shear.ball import BallContact, BallPose
from validation.shear.cases import DIRECTION, FRICTION, GRID_MM, REACH_MM, SHEAR_STEPS, say
from validation.shear.gel_block import GelBlock

SHARES = (0.2, 0.4, 0.6, 0.8)


@dataclass(frozen=True)
class Check:
    """One quantity: what the finite elements give and what the closed form says."""

    name: str
    found: float
    expected: float

    @property
    def off(self) -> float:
        """Relative difference."""
        return self.found / self.expected - 1


def layer_factor(reach: float, poisson: float) -> float:
    """How much stiffer a bonded layer is than a half-space, for ``reach`` = √(Rδ)/thickness.

    Source: Dimitriadis et al. 2002, Eq. 12, with the constants of a bonded layer.
    """
    a = -(1.2876 - 1.4678 * poisson + 1.3442 * poisson**2) / (1 - poisson)
    b = (0.6387 - 1.0277 * poisson + 1.5164 * poisson**2) / (1 - poisson)
    pi = np.pi
    terms = (
        1.0,
        -2 * a / pi,
        4 * a**2 / pi**2,
        -8 / pi**3 * (a**3 + 4 * pi**2 / 15 * b),
        16 * a / pi**4 * (a**3 + 3 * pi**2 / 5 * b),
    )
    return float(sum(term * reach**k for k, term in enumerate(terms)))


def press_force_n(block: GelBlock, radius_mm: float, depth_mm: float) -> float:
    """Of a smooth ball on a bonded layer."""
    stiff = block.young_n_mm2 / (1 - block.poisson**2)
    factor = layer_factor(np.sqrt(radius_mm * depth_mm) / block.thickness_mm, block.poisson)
    return float(4 / 3 * stiff * np.sqrt(radius_mm) * depth_mm**1.5 * factor)


def half_space_checks(fine_mm: float = 0.05) -> list[Check]:
    """A small contact on a thick block: forces, radii, moments."""
    block = GelBlock(6.0, fine_mm, 12.0, 12.0, knots_mm=(0.7, 1.2))
    radius_mm, depth_mm = 2.0, 0.12
    ball = BallContact(block, radius_mm, 0.0, 0.7)
    pressed = ball.to(ball.start(), BallPose(depth_mm), 4)
    normal_n = ball.normal_n(pressed)
    shear = block.young_n_mm2 / (2 * (1 + block.poisson))
    stiff = block.young_n_mm2 / (1 - block.poisson**2)
    # The radius of Hertz' contact under the force found: the layer's stiffness drops out.
    radius = float((3 * normal_n * radius_mm / (4 * stiff)) ** (1 / 3))
    deepest = -pressed.force_n[:, 2] / ball.area_mm2
    found = [
        Check("press: force, N", normal_n, press_force_n(block, radius_mm, depth_mm)),
        Check("press: contact radius, mm", ball.contact_radius_mm(pressed), radius),
        Check(
            "press: pressure in the middle, N/mm²",
            float(deepest.max()),
            3 * normal_n / (2 * np.pi * radius**2),
        ),
    ]
    ball.friction = FRICTION
    sheared = pressed
    for share in SHARES:
        sheared = ball.sheared_to(sheared, DIRECTION, share, 2 * SHEAR_STEPS)
        reached = float(np.hypot(*ball.shear_n(sheared))) / (FRICTION * ball.normal_n(sheared))
        sticks = float(np.sqrt(ball.area_mm2[ball.slipping(sheared) == 1].sum() / np.pi))
        moved = float(np.hypot(sheared.pose.x_mm, sheared.pose.y_mm))
        slides = 3 * FRICTION * normal_n * (2 - block.poisson) / (16 * shear * radius)
        found += [
            Check(f"shear {share}: stick radius, mm", sticks, radius * (1 - reached) ** (1 / 3)),
            Check(f"shear {share}: motion, mm", moved, slides * (1 - (1 - reached) ** (2 / 3))),
        ]
    found.append(
        Check(
            "turn: most moment, N mm",
            ball.most_torque_n_mm(pressed),
            3 * np.pi / 16 * FRICTION * normal_n * radius,
        )
    )
    return found


def layer_checks() -> list[Check]:
    """Smooth balls on the gel's own thicknesses."""
    found = []
    for thickness, radius, depth in (
        (4.0, 2.0, 0.3),
        (4.0, 4.0, 0.6),
        (4.0, 8.0, 0.3),
        (2.5, 4.0, 0.3),
    ):
        block = GelBlock(thickness_mm=thickness)
        ball = BallContact(block, radius, 0.0, REACH_MM[radius])
        pressed = ball.to(ball.start(), BallPose(depth), 4)
        expected = press_force_n(block, radius, depth)
        name = f"press, gel {thickness:g}, ball {radius:g}, depth {depth:g} mm: force, N"
        found.append(Check(name, ball.normal_n(pressed), expected))
    return found


def refinement(sizes_mm: tuple[float, ...] = (0.3, 0.2, 0.15, 0.12)) -> list[tuple[float, ...]]:
    """By mesh, of a ball of 4 mm moved by 0.3 mm: its size, F_n, F_s, the contact's radius.

    Last comes the RMS difference of the surface's motion from the finest mesh's, over the largest.
    """
    fields, rows = [], []
    for size in sizes_mm:
        block = GelBlock(fine_mm=size)
        ball = BallContact(block, 4.0, FRICTION, REACH_MM[4.0])
        touch = ball.to(ball.start(), BallPose(0.6), 10)
        touch = ball.to(touch, BallPose(0.6, 0.3), 10)
        surface = block.surface(ball.index, ball.sides, touch.force_n)
        fields.append(surface.at(GRID_MM.reshape(-1, 2))[:, :2])
        rows.append(
            (
                size,
                ball.normal_n(touch),
                float(ball.shear_n(touch)[0]),
                ball.contact_radius_mm(touch),
            )
        )
    largest = float(np.hypot(*fields[-1].T).max())
    differences = [
        float(np.sqrt(((field - fields[-1]) ** 2).sum(axis=1).mean())) / largest for field in fields
    ]
    return [(*row, difference) for row, difference in zip(rows, differences, strict=True)]


def main() -> None:
    """Print all."""
    for check in (*half_space_checks(), *layer_checks()):
        say(f"{check.name:58s} {check.found:9.4f} {check.expected:9.4f} {100 * check.off:+6.1f} %")
    say("mesh, mm   F_n, N   F_s, N   radius, mm   motion off the finest")
    for size, normal, shear, radius, off in refinement():
        say(f"{size:8.2f} {normal:8.4f} {shear:8.4f} {radius:9.3f} {100 * off:14.2f} %")


if __name__ == "__main__":
    main()
