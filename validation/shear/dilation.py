"""How pressing and shearing move the markers: by finite elements, and measured ones of others.

``python -m validation.shear.dilation [--fots DIR] [--taxim DIR]``. Without a folder: the motion by
pressing alone, of the finite elements, beside today's constants and beside a form whose two
constants are fitted on balls of 2 and 8 mm on a gel of 4 mm; the ball of 4 mm and the gel of 2.5 mm
are held out. With clones of Rancho-zhao/FOTS (commit 5bcde04: 99 markers of a GelSight under a
printed ball of 3 mm, pressed, then sheared) and CMURoboTouch/Taxim (commit d067cc6, MIT: a pin on
a domed gel by finite elements), the same forms and the decay of the shear on those; nothing of
them is kept here.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

from tacgen.contact.gel_shear import DECAY_PER_GEL_DEPTH
from tacgen.contact.shear import dilation_mm
from tacgen.contact.shear_field import ShearField
from validation.shear.cases import GRID_MM, State, cases, say, solved
from validation.shear.gel_block import Float64
from validation.shear.referee import RIGID_DECAY_PER_MM2, Foundation

REACH, GAIN = 1.58, 0.198
"""Of the proposed form, as ``fitted`` finds them: the reach is a share of the gel's thickness."""
STEP_MM = 0.25
FOTS_MM_PER_PX = 0.0266 * 2
FOTS_BALL_MM = 3.0
FOTS_CENTER_PX = (138.0, 124.0)
FOTS_CONTACT_MM = 2.1
"""Centre and radius of the ball's rings in the picture, by eye, to ± 0.3 mm."""
ROBUST_MM = 0.05  # about a pixel: the markers are tracked in whole pixels, and one is lost


@dataclass(frozen=True)
class Press:
    """Points (n, 2), their true motion (n, 2), and the foundation's patch under the ball."""

    name: str
    thickness_mm: float
    points_mm: Float64
    motion_mm: Float64
    patch_mm: Float64
    depth_mm: Float64
    area_mm2: float
    held: Float64
    """The indentation over the deepest at each point (n,)."""
    inside: NDArray[np.bool_]


def press(
    name: str,
    thickness_mm: float,
    points: Float64,
    motion: Float64,
    ball: Foundation,
    edge_mm: float,
) -> Press:
    """A press about the origin; ``edge_mm`` is the radius of the contact."""
    axis = (np.arange(64) - 31.5) * STEP_MM
    patch = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    depth = ball.at(patch)
    return Press(
        name=name,
        thickness_mm=thickness_mm,
        points_mm=points,
        motion_mm=motion,
        patch_mm=patch[depth > 0],
        depth_mm=depth[depth > 0],
        area_mm2=STEP_MM**2,
        held=ball.at(points) / ball.depth_mm,
        inside=np.hypot(*points.T) < edge_mm,
    )


def of_today(one: Press) -> Float64:
    """The motion (n, 2) that tacgen gives markers."""
    return dilation_mm(one.points_mm, one.patch_mm, one.depth_mm, one.area_mm2)


def gaussian(one: Press, gain: float, decay_per_mm2: float) -> Float64:
    """Today's form with other constants: Σ depth · area · (x - x_j) exp(-λ |x - x_j|²)."""
    apart = one.points_mm[:, None] - one.patch_mm
    weight = one.depth_mm * one.area_mm2 * np.exp(-decay_per_mm2 * (apart**2).sum(axis=-1))
    return gain * (weight[..., None] * apart).sum(axis=1)


def proposed(one: Press, reach: float = REACH, gain: float = GAIN) -> Float64:
    """The same with the gel's thickness as its length, and the patch held by the object.

    A bonded gel has one length, its thickness T, and what is pressed aside is a volume: hence
    λ = 1 / (reach · T)² and gain / T³. The object holds the gel where it touches, the more the
    deeper: the factor 1 - depth / deepest.
    """
    thickness = one.thickness_mm
    free = gaussian(one, gain / thickness**3, 1 / (reach * thickness) ** 2)
    return (1 - one.held)[:, None] * free


def fitted(presses: Sequence[Press]) -> tuple[float, float]:
    """Reach and gain of ``proposed``, each press weighed by its largest motion."""

    def off(constants: Float64) -> Float64:
        parts = [
            (proposed(one, *constants) - one.motion_mm).ravel() / _largest(one.motion_mm)
            for one in presses
        ]
        return np.concatenate(parts)

    reach, gain = least_squares(off, [1.0, 0.1], diff_step=1e-3).x
    return float(reach), float(gain)


def _largest(motion: Float64) -> float:
    return float(np.hypot(*motion.T).max())


def errors(one: Press, found: Float64) -> tuple[float, float]:
    """RMS error inside and outside of the contact, per cent of the largest motion."""
    off2 = ((found - one.motion_mm) ** 2).sum(axis=1)
    shares = [
        100 * float(np.sqrt(off2[part].mean())) / _largest(one.motion_mm)
        for part in (one.inside, ~one.inside)
    ]
    return shares[0], shares[1]


def referee_presses() -> list[Press]:
    """All balls and depths on both gels, pressed only."""
    plain = [case for case in cases() if case.path[0] == ("shear", 0.3)]
    states: list[State] = []
    for case in plain:
        states += solved(replace(case, path=()))
    points = GRID_MM.reshape(-1, 2)
    found = []
    for state in states:
        thickness = state.case.thickness_mm
        own = [other for other in states if other.case.thickness_mm == thickness]
        force = np.array([other.normal_n for other in own])
        volume = np.array([other.volume_mm3 for other in own])
        k_n = float(volume @ force / (force @ force))
        ball = Foundation(state.case.radius_mm, k_n * state.normal_n)
        motion = state.surface.at(points)[:, :2]
        edge = state.contact_radius_mm
        found.append(press(state.case.name, thickness, points, motion, ball, edge))
    return found


def print_referee() -> None:
    """Fit on two balls; say every press's error before and after."""
    presses = referee_presses()
    chosen = [one for one in presses if one.thickness_mm == 4.0 and not one.name.startswith("r4")]
    reach, gain = fitted(chosen)
    say(f"fitted on balls of 2 and 8 mm, gel of 4 mm: reach {reach:.3f} T, gain {gain:.3f}")
    say(f"{'press':12s} {'largest, mm':>12s} {'today, % in/out':>18s} {'proposed':>12s}")
    for one in presses:
        before, after = errors(one, of_today(one)), errors(one, proposed(one, reach, gain))
        note = "" if one in chosen else "  held out"
        say(
            f"{one.name:12s} {_largest(one.motion_mm):12.3f} {before[0]:10.0f} {before[1]:7.0f} "
            f"{after[0]:7.1f} {after[1]:5.1f}{note}"
        )


def read_fots(folder: Path) -> tuple[Press, Float64]:
    """The press, and how the shear after it moved the same markers (n, 2), mm."""
    read = [
        np.genfromtxt(folder / f"marker_calib/data/{k}.csv", delimiter=",", skip_header=1)
        for k in (0, 1)
    ]
    points = (read[0][:, :2] - FOTS_CENTER_PX) * FOTS_MM_PER_PX
    moved = [one[:, 2:] * FOTS_MM_PER_PX for one in read]
    depth = FOTS_BALL_MM - np.sqrt(FOTS_BALL_MM**2 - FOTS_CONTACT_MM**2)
    ball = Foundation(FOTS_BALL_MM, np.pi * depth**2 * (FOTS_BALL_MM - depth / 3))
    one = press("FOTS", 4.0, points, moved[0], ball, FOTS_CONTACT_MM)
    return one, moved[1] - moved[0]


def robust_fit(
    form: Callable[[Float64], Float64], start: Sequence[float], truth: Float64
) -> tuple[Float64, Float64]:
    """Constants and what is left (n, 2), with a common drift of all markers taken off."""

    def off(constants: Float64) -> Float64:
        return (form(constants[2:]) + constants[:2] - truth).ravel()

    fit = least_squares(off, [0.0, 0.0, *start], loss="soft_l1", f_scale=ROBUST_MM)
    return fit.x[2:], off(fit.x).reshape(-1, 2)


def _line(
    name: str, constants: Float64, left: Float64, near: NDArray[np.bool_], unit: str = "mm"
) -> None:
    sound = np.hypot(*left.T) < np.quantile(np.hypot(*left.T), 0.98)  # the marker that is lost
    rms = [float(np.sqrt((left[part & sound] ** 2).sum(axis=1).mean())) for part in (near, ~near)]
    say(
        f"  {name:44s} {np.array2string(constants, precision=3):18s} "
        f"{rms[0]:.3f} {rms[1]:.3f} {unit}"
    )


def print_fots(folder: Path) -> None:
    """Dilation and decay of one real press, pulled aside."""
    one, sheared = read_fots(folder)
    near = np.hypot(*one.points_mm.T) < 3.0
    say("FOTS, pressed: RMS within and beyond 3 mm; a common drift is taken off")
    forms: dict[str, tuple[Callable[[Float64], Float64], tuple[float, ...]]] = {
        "no motion": (lambda _c: 0 * one.motion_mm, ()),
        "today: gain 0.03, λ 0.479": (lambda _c: of_today(one), ()),
        "proposed, gel of 4 mm": (lambda _c: proposed(one), ()),
        "proposed, the gel's thickness fitted": (
            lambda c: proposed(replace(one, thickness_mm=c[0])),
            (2.0,),
        ),
        "today's form, gain and λ fitted": (lambda c: gaussian(one, c[0], c[1]), (0.1, 0.5)),
        "proposed + a near part, gain and λ fitted": (
            lambda c: proposed(one) + gaussian(one, c[0], c[1]),
            (0.1, 0.5),
        ),
    }
    for name, (form, start) in forms.items():
        _line(name, *robust_fit(form, start, one.motion_mm), near)
    say("FOTS, then sheared: the same, as shares of the largest motion, and the decay")
    lattice = ShearField(0.5 * 36, 0.5 * 28, 1.0)
    ball = Foundation(FOTS_BALL_MM, float(one.depth_mm.sum() * one.area_mm2))
    pressure = ball.over(lattice.nodes_mm, lattice.lattice_mm)
    _print_decays(one.points_mm, sheared, near, pressure, 0.5, FOTS_CONTACT_MM, drifts=True)


def print_taxim(folder: Path) -> None:
    """Decay of the shear about a pin, by the finite elements of Taxim's authors."""
    read = {
        kind: [
            np.loadtxt(
                folder / f"calibs/0705_dome_node_{kind}_0.3/0705_dome_node_{kind}_0.3_{axis}.txt",
                skiprows=1,
            )
            for axis in "xy"
        ]
        for kind in ("dz", "dxdz")
    }
    places = read["dz"][0][:, 1:4] * 1e3
    moved = [np.stack([a[:, 4] for a in read[kind]], axis=1) * 1e3 for kind in ("dz", "dxdz")]
    apex = places[places[:, 2] < places[:, 2].min() + 0.003, :2].mean(axis=0)
    points, sheared = places[:, :2] - apex, moved[1] - moved[0]
    away = np.hypot(*points.T)
    kept = (away > 0.5) & (away < 8.0) & (places[:, 2] < places[:, 2].min() + 1.5)
    say("Taxim's pin: RMS within 3 mm and beyond (to 8 mm), of the largest motion, and the decay")
    lattice = ShearField(0.25 * 80, 0.25 * 80, 1.0, 0.25)
    pressure = (np.hypot(*np.moveaxis(lattice.nodes_mm, -1, 0)) < 0.25).astype(float)
    _print_decays(points[kept], sheared[kept], away[kept] < 3.0, pressure, 0.25, 0.25)


def _print_decays(
    points: Float64,
    sheared: Float64,
    near: NDArray[np.bool_],
    pressure: Float64,
    lattice_mm: float,
    edge_mm: float,
    drifts: bool = False,
) -> None:
    """The rigid shift's decay and the field's, each as it is and fitted; forces are fitted.

    With ``drifts`` so is a motion that all points have in common.
    """
    largest = _largest(sheared)
    common = [np.broadcast_to(axis, sheared.shape) for axis in np.eye(2)] if drifts else []

    def left(basis: Sequence[Float64]) -> Float64:
        matrix = np.stack([one.ravel() for one in (*basis, *common)], axis=1)
        factors = least_squares(
            lambda f: matrix @ f - sheared.ravel(), np.zeros(matrix.shape[1]), loss="soft_l1",
            f_scale=0.2 * largest,
        ).x  # fmt: skip
        return (matrix @ factors).reshape(-1, 2) - sheared

    def rigid(decay: float) -> Float64:
        beside = np.maximum(0.0, np.hypot(*points.T) - edge_mm)
        share = np.exp(-decay * beside**2)
        zero = 0 * share
        return left([np.stack([share, zero], axis=1), np.stack([zero, share], axis=1)])

    def field(decay_mm: float) -> Float64:
        rows, columns = pressure.shape
        own = ShearField(columns * lattice_mm, rows * lattice_mm, decay_mm, lattice_mm)
        own.tolerance, basis = 1e-4, []
        for pull in np.eye(2):
            state = own.step(pressure, pull, 0.0, np.zeros(2), np.inf)
            basis.append(own.motion_mm(state, points, 1.0))
        return left(basis)

    def best(form: Callable[[float], Float64], low: float, high: float) -> float:
        found = minimize_scalar(
            lambda log: float(np.abs(form(float(np.exp(log)))).mean()),
            bounds=(np.log(low), np.log(high)), method="bounded", options={"xatol": 0.03},
        )  # fmt: skip
        return float(np.exp(found.x))

    usual = DECAY_PER_GEL_DEPTH * 4.0
    own_rigid, own_field = best(rigid, 0.001, 2.0), best(field, 0.3, 12.0)
    for name, constant, off in (
        ("rigid shift, as published", RIGID_DECAY_PER_MM2, rigid(RIGID_DECAY_PER_MM2)),
        ("rigid shift, fitted (per mm²)", own_rigid, rigid(own_rigid)),
        ("field, of a gel of 4 mm (mm)", usual, field(usual)),
        ("field, fitted (mm)", own_field, field(own_field)),
    ):
        _line(name, np.array([constant]), off / largest, near, "of the largest")


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--fots", type=Path, help="a clone of Rancho-zhao/FOTS")
    parser.add_argument("--taxim", type=Path, help="a clone of CMURoboTouch/Taxim")
    given = parser.parse_args()
    if given.fots is None and given.taxim is None:
        print_referee()
    if given.fots is not None:
        print_fots(given.fots)
    if given.taxim is not None:
        print_taxim(given.taxim)


if __name__ == "__main__":
    main()
