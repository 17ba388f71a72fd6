"""The gel's shear by finite elements beside tacgen's field, and beside a rigid shift that decays.

Run it with ``python -m validation.shear.referee --out DIR [--quick]``; it needs scikit-fem and
takes 3 CPU minutes, 1 with ``--quick``. Each gel is calibrated as a user would: k_n, k_s and the
decay's default; nothing is fitted to the fields that are compared. Written are ``errors.csv`` and
pictures.
"""

import argparse
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.contact.gel_shear import DECAY_PER_GEL_DEPTH, GelShear
from tacgen.contact.shear import dilation_mm, marker_pitch_mm
from tacgen.contact.shear_field import ShearState
from tacgen.core.sensors import load_sensor
from validation.shear.cases import FRICTION, GRID_MM, State, cases, mini_markers_mm, say, solved
from validation.shear.gel_block import Float64

RIGID_DECAY_PER_MM2 = 0.0805
"""The rigid shift falls off by exp(-λ d²) with the distance d to the patch.

Source: Zhao et al. 2023, FOTS: λ_s = 0.00021 px⁻² at its 19.58 px/mm.
"""
FINE = 10  # points along a cell over which its indentation is averaged
DRAWN = ("press", "shear 0.7", "shear 1", "turn 0.9", "turn 0.4", "shear -0.7")


@dataclass(frozen=True)
class Calibration:
    """What a user finds on one gel: V = k_n F_n and ∫ u dA = c F_s."""

    k_n_mm3_per_n: float
    compliance_mm3_per_n: float

    @classmethod
    def of(cls, states: Iterable[State]) -> "Calibration":
        """By least squares over presses, and over the markers' sums at the lightest shear."""
        pitch = marker_pitch_mm(load_sensor("gelsight_mini"))
        markers = mini_markers_mm()
        pressed: list[State] = []
        pulls: list[float] = []
        sums: list[float] = []
        for state in states:
            if state.stop == "press":
                pressed.append(state)
            elif state.stop == "1: shear 0.3":
                moved = state.surface.at(markers) - pressed[-1].surface.at(markers)
                pulls += list(state.shear_n)
                sums += list(pitch**2 * moved[:, :2].sum(axis=0))
        force = np.array([state.normal_n for state in pressed])
        volume = np.array([state.volume_mm3 for state in pressed])
        pull = np.array(pulls)
        return cls(
            float(volume @ force / (force @ force)), float(pull @ np.array(sums) / (pull @ pull))
        )


class Foundation:
    """The indentation of a ball for which V = k_n F_n, on points of a grid."""

    def __init__(self, radius_mm: float, volume_mm3: float) -> None:
        self.radius_mm = radius_mm
        low, high = 0.0, radius_mm
        for _ in range(60):  # V = π δ² (R - δ/3)
            self.depth_mm = (low + high) / 2
            if np.pi * self.depth_mm**2 * (radius_mm - self.depth_mm / 3) > volume_mm3:
                high = self.depth_mm
            else:
                low = self.depth_mm

    def at(self, points_mm: Float64) -> Float64:
        """Indentation (...) at points (..., 2)."""
        away2 = np.minimum((points_mm**2).sum(axis=-1), self.radius_mm**2)
        sag = self.radius_mm - np.sqrt(self.radius_mm**2 - away2)
        return np.asarray(np.maximum(0.0, self.depth_mm - sag))

    def over(self, nodes_mm: Float64, cell_mm: float) -> Float64:
        """Its mean (rows, columns) over square cells about nodes."""
        offsets = ((np.arange(FINE) + 0.5) / FINE - 0.5) * cell_mm
        parts = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        return np.asarray(self.at(nodes_mm[:, :, None, :] + parts).mean(axis=-1))


class Model:
    """tacgen's field over the states of one case, in their order."""

    def __init__(self, calibration: Calibration, thickness_mm: float, decay_mm: float) -> None:
        self.calibration, self.thickness_mm = calibration, thickness_mm
        self.field = GelShear(load_sensor("gelsight_mini")).field(decay_mm)
        self._before: ShearState | None = None

    def follows(self, state: State) -> Float64:
        """The shear's motion (n, m, 2) on the grid after one more state."""
        if state.stop == "press":
            self._before = None
        volume = self.calibration.k_n_mm3_per_n * state.normal_n
        ball, cell = Foundation(state.case.radius_mm, volume), self.field.lattice_mm
        depth = ball.over(self.field.nodes_mm, cell)
        pressure = depth * state.normal_n / (depth.sum() * cell**2)
        self._before = self.field.step(
            pressure, state.shear_n, state.torque_n_mm, np.zeros(2), FRICTION, self._before
        )
        moved = self.field.motion_mm(
            self._before, GRID_MM.reshape(-1, 2), self.calibration.compliance_mm3_per_n
        )
        return moved.reshape(GRID_MM.shape)

    def dilated(self, state: State) -> Float64:
        """The motion (n, m, 2) by pressing alone, on the grid."""
        patch, depth, area = _patch(state, self.calibration)
        return dilation_mm(GRID_MM.reshape(-1, 2), patch, depth, area).reshape(GRID_MM.shape)


def _patch(state: State, calibration: Calibration) -> tuple[Float64, Float64, float]:
    """Points (k, 2) of the foundation's patch, their depths (k,) and the area of each."""
    ball = Foundation(state.case.radius_mm, calibration.k_n_mm3_per_n * state.normal_n)
    step = 0.2
    axis = (np.arange(60) - 29.5) * step
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    depth = ball.at(points)
    return points[depth > 0], depth[depth > 0], step**2


def rigid_shift(state: State, calibration: Calibration) -> Float64:
    """The object's shift and turn times a decay about the patch (n, m, 2), which knows no slip.

    The markers' sums are what the law predicts: D = k_s F_s, and so for the moment.
    """
    patch, _depth, area = _patch(state, calibration)

    def follows(points_mm: Float64) -> Float64:
        away2 = ((points_mm[:, None] - patch) ** 2).sum(axis=-1).min(axis=1)
        return np.asarray(np.exp(-RIGID_DECAY_PER_MM2 * np.maximum(0.0, away2 - area)))

    markers = mini_markers_mm()
    pitch = marker_pitch_mm(load_sensor("gelsight_mini"))
    share = follows(markers)
    k_s = calibration.compliance_mm3_per_n / pitch**2
    shift_mm = k_s * state.shear_n / share.sum()
    turn_rad = k_s * state.torque_n_mm / float((share * (markers**2).sum(axis=1)).sum())
    points = GRID_MM.reshape(-1, 2)
    turned = turn_rad * np.stack([-points[:, 1], points[:, 0]], axis=1)
    return (follows(points)[:, None] * (shift_mm + turned)).reshape(GRID_MM.shape)


def rms_shares(
    found: Float64, truth: Float64, inside: NDArray[np.bool_], scale: Float64 | None = None
) -> tuple[float, float]:
    """RMS error within and beyond the patch, each over the largest motion of ``scale`` there.

    ``scale`` is the truth itself where it is not given.
    """
    error2 = ((found - truth) ** 2).sum(axis=-1)
    size2 = ((truth if scale is None else scale) ** 2).sum(axis=-1)
    shares = [float(np.sqrt(error2[part].mean() / size2[part].max())) for part in (inside, ~inside)]
    return shares[0], shares[1]


@dataclass(frozen=True)
class Compared:
    """One state's fields (n, m, 2) on the grid, pressing's motion taken off the referee's.

    ``scale`` is the field whose largest motion errors are shares of: the truth, or where the force
    is back at 0 the state's before.
    """

    state: State
    truth: Float64
    model: Float64
    rigid: Float64
    pressed: Float64
    dilated: Float64
    scale: Float64

    @property
    def inside(self) -> NDArray[np.bool_]:
        """The points (n, m) that lie in the true patch."""
        return np.asarray(np.hypot(*np.moveaxis(GRID_MM, -1, 0)) < self.state.contact_radius_mm)

    def share(self, found: Float64) -> tuple[float, float]:
        """RMS error of a field within and beyond the patch."""
        return rms_shares(found, self.truth, self.inside, self.scale)

    def row(self) -> dict[str, object]:
        """One line of the table; errors in per cent."""
        state = self.state
        own, rigid = self.share(self.model), self.share(self.rigid)
        total = self.share(self.model + self.dilated - self.pressed)
        return {
            "case": state.case.name,
            "stop": state.stop,
            "radius_mm": state.case.radius_mm,
            "normal_n": state.normal_n,
            "shear_n": float(np.hypot(*state.shear_n)),
            "torque_n_mm": state.torque_n_mm,
            "largest_mm": float(np.hypot(*np.moveaxis(self.truth, -1, 0)).max()),
            "model_inside": 100 * own[0],
            "model_outside": 100 * own[1],
            "rigid_inside": 100 * rigid[0],
            "rigid_outside": 100 * rigid[1],
            "with_dilation_inside": 100 * total[0],
            "with_dilation_outside": 100 * total[1],
        }


def compared(states: Sequence[State], decay_mm: float | None = None) -> list[Compared]:
    """Every state after a press beside both models, each gel calibrated on its own presses."""
    out: list[Compared] = []
    for thickness in dict.fromkeys(state.case.thickness_mm for state in states):
        own = [state for state in states if state.case.thickness_mm == thickness]
        calibration = Calibration.of(own)
        decay = DECAY_PER_GEL_DEPTH * thickness if decay_mm is None else decay_mm
        model = Model(calibration, thickness, decay)
        say(
            f"gel of {thickness:g} mm: k_n {calibration.k_n_mm3_per_n:.2f} mm³/N, "
            f"c {calibration.compliance_mm3_per_n:.1f} mm³/N, decay {decay:.2f} mm"
        )
        for state in own:
            moved = model.follows(state)
            surface = state.surface.at(GRID_MM.reshape(-1, 2))[:, :2].reshape(GRID_MM.shape)
            if state.stop == "press":
                pressed = surface
                continue
            rigid = rigid_shift(state, calibration)
            dilated = model.dilated(state)
            truth = surface - pressed
            scale = out[-1].scale if state.stop.endswith("shear 0") else truth
            out.append(Compared(state, truth, moved, rigid, pressed, dilated, scale))
    return out


def draw(one: Compared, path: Path) -> None:
    """Arrows of the three fields at equal scale, the true patch as a circle."""
    figure = Figure(figsize=(15, 5), layout="constrained")
    titles = ("finite elements", "tacgen's field", "rigid shift that decays")
    scale = 1.2 / max(float(np.hypot(*np.moveaxis(one.truth, -1, 0)).max()), 1e-9)
    errors = (None, one.share(one.model), one.share(one.rigid))
    for axes, title, field, error in zip(
        figure.subplots(1, 3),
        titles,
        (one.truth, one.model, one.rigid),
        errors,
        strict=True,
    ):
        size = np.hypot(field[..., 0], field[..., 1])
        axes.quiver(
            *np.moveaxis(GRID_MM, -1, 0), field[..., 0] * scale, field[..., 1] * scale, size,
            angles="xy", scale_units="xy", scale=1, width=0.0025, cmap="viridis",
        )  # fmt: skip
        turn = np.linspace(0, 2 * np.pi, 90)
        radius = one.state.contact_radius_mm
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="tab:red", lw=1)
        axes.set(aspect="equal", xlim=(-9.5, 9.5), ylim=(7.5, -7.5), xlabel="x, mm", ylabel="y, mm")
        if error is not None:
            title += f": RMS {100 * error[0]:.0f} % inside, {100 * error[1]:.0f} % outside"
        axes.set_title(title)
    state = one.state
    figure.suptitle(
        f"{state.title}: F_n {state.normal_n:.2f} N, F_s {np.hypot(*state.shear_n):.2f} N, "
        f"moment {state.torque_n_mm:.2f} N mm; the longest arrow is {1.2 / scale:.2f} mm"
    )
    figure.savefig(path, dpi=80)


def main() -> None:
    """Solve, compare, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="one depth, one gel")
    parser.add_argument("--decay-mm", type=float, help="instead of the sensor's own")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    states = [state for case in cases(given.quick) for state in solved(case)]
    found = compared(states, given.decay_mm)
    table = pd.DataFrame([one.row() for one in found])
    table.to_csv(given.out / "errors.csv", index=False)
    with pd.option_context("display.width", 200, "display.max_rows", None):
        say(table.round(3).to_string(index=False))
    errors = ["model_inside", "rigid_inside", "model_outside", "rigid_outside"]
    errors += ["with_dilation_inside", "with_dilation_outside"]
    kinds = table["case"].str.extract(r"d[\d.]+ ?(.*)")[0].replace("", "shear").to_numpy()
    say("mean over states, %:")
    say(table.groupby([kinds, "radius_mm"])[errors].mean().round(1).to_string())
    say(table[errors].agg(["mean", "max"]).round(1).to_string())
    for one in found:
        name = one.state.title.replace(": ", "_").replace(" ", "_")
        if any(stop in one.state.stop for stop in DRAWN):
            draw(one, given.out / f"{name}.png")
    say(f"{given.out}: errors.csv and pictures")


if __name__ == "__main__":
    main()
