"""The referee against closed forms: run it with ``python -m validation.shear.checks``.

A ball pressed on a layer that is bonded to its base, then sheared (Cattaneo 1938, Mindlin 1949) and
turned; and the gel's own mesh refined.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.optimize import brentq

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


def layer_press(block: GelBlock, radius_mm: float, depth_mm: float) -> tuple[float, float]:
    """Force, N, and contact radius, mm, of a smooth ball on an endless layer bonded to its base.

    The pressure is φ's transform, A(k) = ∫ φ(t) cos(kt) dt up to the contact's radius, where φ = 0;
    φ obeys a Fredholm equation whose kernel is by how much the layer is stiffer than a half-space.

    Source: Lebedev & Ufliand 1958; the layer's compliance: Johnson 1985, Contact Mechanics, § 5.8;
    the sphere's profile: Sneddon 1965.
    """
    kappa, height = 3 - 4 * block.poisson, block.thickness_mm
    wave, wave_weight = (part * 20 / height for part in leggauss(400))  # L - 1 falls as exp(-2kh)
    wave = wave + 20 / height
    kh = wave * height
    stiffer = (2 * kappa * np.sinh(2 * kh) - 4 * kh) / (
        2 * kappa * np.cosh(2 * kh) + 1 + kappa**2 + 4 * kh**2
    ) - 1
    node, weight = leggauss(48)
    shear = block.young_n_mm2 / (2 * (1 + block.poisson))

    def at(contact_mm: float) -> tuple[float, float]:
        """φ at the rim, and the force."""
        t, dt = contact_mm * (node + 1) / 2, contact_mm * weight / 2
        waves = np.cos(np.outer(wave, t)) * np.sqrt(2 / np.pi)
        rim = np.cos(wave * contact_mm) * np.sqrt(2 / np.pi) * wave_weight * stiffer
        kernel = (waves.T * (wave_weight * stiffer)) @ waves
        profile = 2 / np.pi * (depth_mm - t * np.arctanh(t / radius_mm))
        phi = np.linalg.solve(np.eye(len(t)) + kernel * dt, profile)
        at_rim = 2 / np.pi * (depth_mm - contact_mm * np.arctanh(contact_mm / radius_mm))
        at_rim -= rim @ waves @ (dt * phi)
        return float(at_rim), float(2 * np.pi * shear / (1 - block.poisson) * (dt @ phi))

    hertz = np.sqrt(radius_mm * depth_mm)
    most = min(0.98 * radius_mm, 2 * hertz)
    contact = float(brentq(lambda edge: at(edge)[0], 0.3 * hertz, most))
    return at(contact)[1], contact


def half_space_checks(fine_mm: float = 0.05) -> list[Check]:
    """A small contact on a thick block: forces, radii, moments."""
    block = GelBlock(6.0, fine_mm, 12.0, 12.0, knots_mm=(0.7, 1.2))
    radius_mm, depth_mm = 2.0, 0.12
    ball = BallContact(block, radius_mm, 0.0, 0.7)
    pressed = ball.to(ball.start(), BallPose(depth_mm), 4)
    normal_n = ball.normal_n(pressed)
    shear = block.young_n_mm2 / (2 * (1 + block.poisson))
    force, radius = layer_press(block, radius_mm, depth_mm)
    deepest = -pressed.force_n[:, 2] / ball.area_mm2
    found = [
        Check("press: force, N", normal_n, force),
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
        force, contact = layer_press(block, radius, depth)
        name = f"gel {thickness:g}, ball {radius:g}, depth {depth:g} mm:"
        found.append(Check(f"{name} force, N", ball.normal_n(pressed), force))
        found.append(Check(f"{name} radius, mm", ball.contact_radius_mm(pressed), contact))
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
