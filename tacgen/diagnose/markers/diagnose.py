"""What the field of marker motion lacks that its sum cannot show."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.calibrate.contact.marker_fit import (
    FieldData,
    Slip,
    arrow_figure,
    field_data,
    refined,
)
from tacgen.contact.law import ContactLaw
from tacgen.core.records import Estimate, Sensor
from tacgen.core.types import FloatArray
from tacgen.diagnose import record
from tacgen.diagnose.engine import reached, search
from tacgen.diagnose.evidence import Dependence, followed_by_rank
from tacgen.diagnose.markers.problem import (
    PARTIAL_SLIP,
    SHIFTED,
    TURNED,
    FrictionProblem,
    Grid,
    free,
    squares,
)
from tacgen.diagnose.rules import MARKERS, MarkerRules
from tacgen.presses.marker_tracks import MarkerTracks


@dataclass(frozen=True)
class MarkerDiagnosis(record.Summarised):
    """What the residual of the marker field was traced to.

    ``base`` is fitted to the presses that are not held out, ``final`` to all; ``data`` are their
    frames. Errors, mm, are of one coordinate of a dot in held-out presses, before and after;
    ``gains`` are the shares of the squared error there that effects take away, in the order in
    which they were added. ``beside_mm`` (M, 2) is by how much dots at rest are off where the base,
    and the extended field, have them.
    """

    data: FieldData
    base: Slip
    final: Slip
    effects: dict[str, dict[str, Estimate]]
    gains: dict[str, float]
    runner_up: dict[str, str]
    before_mm: float
    after_mm: float
    motion_mm: float
    unexplained: tuple[Dependence, ...]
    k_s: Estimate
    decay: Estimate
    n_test: int
    beside_mm: tuple[FloatArray, FloatArray]

    @property
    def summary(self) -> record.Summary:
        """Verdict and sentence, in µm."""
        lacking = []
        for name, parameters in self.effects.items():
            shown = ", ".join(
                f"{key} {one.value:.3g} ± {1.96 * one.stderr:.2g}"
                for key, one in parameters.items()
            )
            lacking.append(f"{name.replace('_', ' ')} ({shown})")
        return record.Summary(
            "The shear field that sticks",
            lacking,
            [one.covariate for one in self.unexplained],
            before=1e3 * self.before_mm,
            after=1e3 * self.after_mm,
            floor=1e3 * self.data.noise_mm,
            unit="um",
            held="held-out presses",
        )

    def extended(self, law: ContactLaw) -> ContactLaw:
        """The law with what the field says that it lacks."""
        found: dict[str, Any] = {"decay_mm": self.decay}
        if PARTIAL_SLIP in self.effects:
            found["friction"] = self.effects[PARTIAL_SLIP]["friction"]
        if np.isnan(law.k_s_mm_per_n.value):
            found["k_s_mm_per_n"] = self.k_s
        if np.isnan(law.marker_pitch_mm):
            found["marker_pitch_mm"] = self.data.tracks.pitch_mm
        return replace(law, **found)

    def figure(self, *, extended: bool) -> Figure:
        """Arrows of a few presses, of the field that sticks or with the effects that were found."""
        grip, beside_mm = (self.base, self.final)[extended], self.beside_mm[extended]
        linear = self.data.linear(grip, range(len(self.data.presses)))
        return arrow_figure(self.data, grip, linear, beside_mm)

    def record(self) -> dict[str, Any]:
        """The channel ``markers`` of ``diagnosis.json``."""

        def reported(one: Estimate) -> dict[str, Any]:
            return record.estimate(one.value, one.stderr, one.unit)

        return record.channel_record(
            self,
            effects=[
                {
                    "name": name,
                    "parameters": {key: reported(one) for key, one in parameters.items()},
                    "heldout_gain": self.gains[name],
                    "runner_up": self.runner_up.get(name, ""),
                }
                for name, parameters in self.effects.items()
            ],
            unexplained=[
                {"covariate": one.covariate, "p_value": one.p_value} for one in self.unexplained
            ],
            errors=(
                record.error(self.before_mm, self.motion_mm, "mm"),
                record.error(self.after_mm, self.motion_mm, "mm"),
            ),
            noise_floor=(
                self.data.noise_mm,
                "second differences of a dot's place over the frames of a press",
            ),
            trials=(len(self.data.presses) - self.n_test, self.n_test),
            field={"k_s": reported(self.k_s), "decay_mm": reported(self.decay)},
        )


def diagnose_markers(
    tracks: MarkerTracks, sensor: Sensor, k_n_mm3_per_n: float, rules: MarkerRules = MARKERS
) -> MarkerDiagnosis:
    """Diagnose the field of marker tracks; ``k_n`` gives the size of the contacts.

    Raises ``PressError`` with too few presses that shear the gel.
    """
    data = field_data(tracks, sensor, k_n_mm3_per_n, rules.frames)
    every = list(range(len(data.presses)))
    test = every[rules.test_every // 2 :: rules.test_every]
    fit = [one for one in every if one not in test]
    friction = FrictionProblem(data, fit, rules)
    steps = search(friction, friction.fitted(()))
    slip = reached(steps)
    grid = Grid(data.tracks)
    beside = grid.needed(friction, slip.grip)
    order = [*slip.members, *beside]
    # Errors and gains on presses that neither fitting nor choosing saw.
    losses = []
    for count in range(len(order) + 1):
        grip = friction.fitted(slip.members[:count]).grip
        linear, offset = data.linear(grip, fit), grid.offset_mm(order[:count])
        losses.append(sum(squares(data, one, grip, linear, offset) for one in test))
    motions = [data.presses[one].motion_mm for one in test]
    seen = np.concatenate([motion[np.isfinite(motion)] for motion in motions])
    # Parameters of all presses.
    final, linear, stderr = refined(data, slip.grip, free(slip.members))
    pitch2, offset = tracks.pitch_mm**2, grid.offset_mm(beside)
    after_mm = float(np.sqrt(losses[-1] / len(seen)))
    competing = {one.members[0] for one in steps[0].tried if friction.accepts(one, one.members[0])}
    first = slip.members[:1]
    return MarkerDiagnosis(
        data=data,
        base=friction.fitted(()).grip,
        final=final,
        effects={name: _parameters(name, final, stderr, grid) for name in order},
        gains={n: 1.0 - b / a for n, a, b in zip(order, losses, losses[1:], strict=False)},
        runner_up={name: other for name in first for other in competing - {name}},
        before_mm=float(np.sqrt(losses[0] / len(seen))),
        after_mm=after_mm,
        motion_mm=float(np.sqrt((seen**2).mean())),
        unexplained=_unexplained(data, final, linear, offset, rules)
        if after_mm > rules.unexplained * data.noise_mm
        else (),
        k_s=Estimate(float(linear[0]) / pitch2, stderr["compliance"] / pitch2, "mm/N"),
        decay=Estimate(final.decay_mm, stderr["decay"], "mm"),
        n_test=len(test),
        beside_mm=(grid.offset_mm(()), offset),
    )


def _unexplained(
    data: FieldData, grip: Slip, linear: FloatArray, offset_mm: FloatArray, rules: MarkerRules
) -> tuple[Dependence, ...]:
    """The column of the log, at the largest shear, that the residual of presses follows."""
    left = np.array(
        [
            squares(data, one, grip, linear, offset_mm) / np.isfinite(press.motion_mm).sum()
            for one, press in enumerate(data.presses)
        ]
    )
    columns = {
        name: np.array([press.load[name] for press in data.presses])
        for name in data.presses[0].load
    }
    known = {
        name: np.where(np.isfinite(values), values, np.nanmedian(values))
        for name, values in columns.items()
        if np.isfinite(values).any()
    }
    rng = np.random.default_rng(len(left))
    groups = [np.arange(len(left))]
    return followed_by_rank(left, known, groups, rules.alpha, rules.n_shuffles, rng)[:1]


def _parameters(name: str, grip: Slip, stderr: dict[str, float], grid: Grid) -> dict[str, Estimate]:
    """An effect's parameters."""
    if name == PARTIAL_SLIP:
        return {"friction": Estimate(grip.friction, stderr["grip"] * grip.friction**2, "1")}
    if name == TURNED:
        return {"turn_rad": Estimate(grid.turn_rad, grid.errors[0], "rad")}
    if name == SHIFTED:
        return {
            f"shift_{axis}_mm": Estimate(float(value), stderr_mm, "mm")
            for axis, value, stderr_mm in zip("xy", grid.shift_mm, grid.errors[1:], strict=True)
        }
    place = grip.place
    if place is None:
        return {}
    mu = place.friction
    return {
        "x_mm": Estimate(place.x_mm, stderr["place_x"], "mm"),
        "y_mm": Estimate(place.y_mm, stderr["place_y"], "mm"),
        "radius_mm": Estimate(place.radius_mm, stderr["place_radius"], "mm"),
        "friction": Estimate(mu, stderr["place_slip"] * mu**2, "1"),
    }
