"""The shear field of marker tracks: k_s, the decay of the gel's motion and its friction.

Of every frame the model is c w(ℓ, μ) + g d: the field w of ``ShearField``, driven by the logged
force, and the dots' motion d away from the indentation. c = k_s · pitch² and g are linear and are
solved for each trial of the decay ℓ and 1/μ, which is 0 where all points stick.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import least_squares

from tacgen.calibrate.contact.rules import FIELD
from tacgen.calibrate.contact.slope_fit import clustered, widened
from tacgen.contact.ball_shear import STICKS, BallShear, Place
from tacgen.contact.noise import noise_of, second_differences
from tacgen.core.errors import PressError
from tacgen.core.records import Estimate, Sensor
from tacgen.core.sensors import load_sensor
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.presses.marker_tracks import (
    AT_REST,
    AXES,
    MarkerTracks,
    read_marker_tracks,
    tracks_in_pictures,
)
from tacgen.presses.press_folder import WITH_FORCES, read_press_folder
from tacgen.presses.press_log import PressLog
from tacgen.report.figures import arrows

PLACE_NAMES = ("place_x", "place_y", "place_radius", "place_slip")
BOUNDS = {
    "decay": (0.3, 8.0),  # of gels 2 to 10 mm thick
    "grip": (0.0, 30.0),  # 1/μ: nothing is that slippery
    "place_x": (-50.0, 50.0),
    "place_y": (-50.0, 50.0),
    "place_radius": (0.5, 6.0),  # less than a cell of the lattice is no place, more is the window
    "place_slip": (0.0, 30.0),
}
"""Of the parameters that are not linear; lengths in mm."""


@dataclass(frozen=True, slots=True)
class PressFrames:
    """One press's frames that are fitted: what acts on the gel and how its dots moved.

    ``pressure`` (T) maps are in N/mm², ``force_n`` (T, 2), ``motion_mm`` and ``dilation_mm``
    (T, M, 2), the first NaN where a dot is lost.
    """

    number: int
    load: Mapping[str, float]
    center_mm: FloatArray
    patch_mm: float
    pressure: tuple[FloatArray, ...]
    force_n: FloatArray
    motion_mm: FloatArray
    dilation_mm: FloatArray
    frames: IntArray


@dataclass(frozen=True, slots=True)
class Slip:
    """The parameters of the field that are not linear."""

    decay_mm: float = FIELD.start_decay_mm
    per_friction: float = 0.0
    place: Place | None = None

    @property
    def friction(self) -> float:
        """μ; a large number where all sticks."""
        return 1.0 / max(self.per_friction, 1.0 / STICKS)


@dataclass
class FieldData:
    """The presses of a session with their tracks, and the strains computed for them."""

    sensor: Sensor
    tracks: MarkerTracks
    presses: tuple[PressFrames, ...]
    noise_mm: float
    _gels: dict[float, BallShear] = field(default_factory=dict)
    _known: dict[Any, FloatArray] = field(default_factory=dict)

    def strain(self, index: int, grip: Slip) -> FloatArray:
        """Motion per compliance (T, M, 2) of a press; a place that it does not reach is nothing."""
        press, place = self.presses[index], grip.place
        if place is not None:
            away = np.hypot(*(press.center_mm - [place.x_mm, place.y_mm]))
            place = place if away < place.radius_mm + press.patch_mm else None
        key = (index, grip.decay_mm, grip.per_friction, place)
        if key not in self._known:
            if len(self._known) > FIELD.most_known:
                self._known.clear()
                self._gels.clear()
            if grip.decay_mm not in self._gels:
                gel = BallShear(self.sensor, grip.decay_mm, FIELD.field_tolerance)
                self._gels[grip.decay_mm] = gel
            self._known[key] = self._gels[grip.decay_mm].strain(
                np.where(np.isfinite(self.tracks.rest_mm), self.tracks.rest_mm, 0.0),
                *(press.pressure, press.force_n, grip.friction, place),
            )
        return self._known[key]

    def linear(self, grip: Slip, which: Sequence[int]) -> FloatArray:
        """Compliance c, mm³/N, and gain of the dilation that fit presses best."""
        found = [self.rows(index, grip) for index in which]
        normal = sum(columns.T @ columns for columns, _ in found)
        right = sum(columns.T @ motion for columns, motion in found)
        return np.asarray(np.linalg.lstsq(normal, right, rcond=1e-12)[0])

    def rows(self, index: int, grip: Slip) -> tuple[FloatArray, FloatArray]:
        """Strain and dilation (n, 2), and motion (n,), of the coordinates that were seen."""
        press = self.presses[index]
        seen = np.isfinite(press.motion_mm)
        columns = [self.strain(index, grip)[seen], press.dilation_mm[seen]]
        return np.column_stack(columns), press.motion_mm[seen]

    def residual(self, index: int, grip: Slip, linear: FloatArray) -> FloatArray:
        """Measured less modelled motion (n,) of a press's coordinates that were seen."""
        columns, motion = self.rows(index, grip)
        return np.asarray(motion - columns @ linear)

    def explained(self, grip: Slip, linear: FloatArray) -> tuple[float, float]:
        """Share of the squared motion beyond the noise that is explained, and what is not, mm²."""
        which = range(len(self.presses))
        motion = np.concatenate([p.motion_mm[np.isfinite(p.motion_mm)] for p in self.presses])
        left = float(self.losses(grip, linear, which).sum()) / len(motion)
        total = float((motion**2).mean())
        return (total - left) / max(total - self.noise_mm**2, 1e-12), left

    def losses(self, grip: Slip, linear: FloatArray, which: Sequence[int]) -> FloatArray:
        """Sum of squares (n,) of each press's residual, mm²."""
        return np.array([(self.residual(index, grip, linear) ** 2).sum() for index in which])


def load_tracks(markers: Path, sensor: str | None, log: PressLog) -> tuple[Sensor, MarkerTracks]:
    """The sensor of that name, and the tracks of a ``markers.csv`` or a folder of pictures.

    Raises ``PressError`` if they cannot be used, or no sensor is named.
    """
    if sensor is None:
        msg = f"{markers}: whose dots are these? Name their sensor with --sensor"
        raise PressError(msg)
    known = load_sensor(sensor, needs_table=False)
    if Path(markers).is_dir():
        return known, tracks_in_pictures(read_press_folder(markers, WITH_FORCES), known, log)
    return known, read_marker_tracks(Path(markers), known, log)


def field_data(
    tracks: MarkerTracks,
    sensor: Sensor,
    k_n_mm3_per_n: float,
    most_frames: int = FIELD.most_frames,
) -> FieldData:
    """The presses that shear the gel, with a few frames of each; ``k_n`` gives the contact's size.

    Raises ``PressError`` with fewer than ``FIELD.least_presses`` of them, or where the tracks are
    written in other axes than the gel's.
    """
    data = _press_frames(tracks, sensor, k_n_mm3_per_n, most_frames)

    def tried(one: FieldData) -> tuple[float, float, float]:
        linear = one.linear(Slip(), range(len(one.presses)))
        return (float(linear[0]), *one.explained(Slip(), linear))

    compliance, share, left = tried(data)
    if share >= FIELD.clear and compliance > 0:
        return data
    found = {}
    for axes, matrix in AXES.items():
        places, rest = (one @ np.transpose(matrix) for one in (tracks.places_mm, tracks.rest_mm))
        other = replace(tracks, places_mm=places, rest_mm=rest)
        found[axes] = tried(_press_frames(other, sensor, k_n_mm3_per_n, FIELD.frames_for_axes))
    axes = min(found, key=lambda one: found[one][2])
    if found[axes][0] > 0 and found[axes][2] < FIELD.other_axes * left:
        msg = (
            f"{tracks.path}: the shear field explains {max(share, 0.0):.0%} of the dots' motion as "
            f"it is written, {found[axes][1]:.0%} where {axes}"
        )
        raise PressError(msg)
    return data


def _press_frames(
    tracks: MarkerTracks, sensor: Sensor, k_n_mm3_per_n: float, most_frames: int
) -> FieldData:
    gel = BallShear(sensor, FIELD.start_decay_mm)
    rest = np.where(np.isfinite(tracks.rest_mm), tracks.rest_mm, 0.0)
    presses, squares = [], []
    for number in np.unique(tracks.press):
        rows = np.flatnonzero(tracks.press == number)
        rows = rows[np.argsort(tracks.time_s[rows], kind="stable")]
        load = {name: values[rows] for name, values in tracks.load.items()}
        motion = tracks.places_mm[rows] - tracks.rest_mm
        force = np.column_stack([load["force_shear_x_n"], load["force_shear_y_n"]])
        normal, size = load["force_normal_n"], np.hypot(*force.T)
        center = np.array([np.median(load["x_mm"]), np.median(load["y_mm"])])
        radius = float(np.median(load["radius_mm"]))
        # The dots far from the contact hardly move: what their places bend by is noise.
        away = np.hypot(*(rest - center).T)
        still = motion[:, away >= np.median(away)]
        courses = np.moveaxis(still, 0, -1).reshape(-1, 1)  # of a coordinate of a dot, one by one
        starts = np.arange(0, len(courses) + 1, len(still))
        squares.append(second_differences(courses, starts)[1])
        known = np.isfinite([*center, radius]).all() and np.isfinite(force).all()
        seen: BoolArray = np.asarray(np.isfinite(motion).any(axis=(1, 2)))
        chosen = _chosen(normal, force, seen, most_frames)
        if not known or len(chosen) < 2 or size[chosen].max() <= AT_REST * normal.max():
            continue
        depth = [gel.depth_mm(radius, center, k_n_mm3_per_n * normal[one]) for one in chosen]
        deepest = max(depth, key=lambda one: float(one.sum()))
        area = float((deepest > 0).sum()) * gel.cell_mm2
        presses.append(
            PressFrames(
                int(number),
                {name: float(values[np.argmax(size)]) for name, values in load.items()},
                gel.middle_mm(deepest),
                float(np.sqrt(area / np.pi)),
                tuple(one / k_n_mm3_per_n for one in depth),
                force[chosen],
                motion[chosen],
                np.stack([gel.dilation_mm(rest, one) for one in depth]),
                rows[chosen],
            )
        )
    if len(presses) < FIELD.least_presses:
        msg = (
            f"{tracks.path}: {len(presses)} presses with shear force, the ball's radius and the "
            f"contact's place; the shear field needs {FIELD.least_presses}"
        )
        raise PressError(msg)
    return FieldData(sensor, tracks, tuple(presses), noise_of(np.concatenate(squares)))


def _chosen(normal: FloatArray, force: FloatArray, usable: BoolArray, most: int) -> IntArray:
    """Frames in contact, spread evenly over the path of the load."""
    rows = np.flatnonzero(usable & (normal > AT_REST * normal.max()))
    if len(rows) <= most:
        return rows
    along = np.column_stack([0.3 * normal[rows], force[rows]])  # shear counts more
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(along, axis=0), axis=1))])
    wanted = np.linspace(0.0, path[-1], most - 1)
    near = np.abs(path[:, None] - wanted).argmin(axis=0)
    top = int(np.hypot(*force[rows].T).argmax())
    return np.asarray(rows[np.unique([*near, top])])


def fit_slip(data: FieldData, which: Sequence[int], start: Slip, names: Sequence[str]) -> Slip:
    """The parameters ``names`` that explain presses best, from ``start`` on; others stay.

    Names are ``decay``, ``grip`` (1/μ) and, of a place, those of ``PLACE_NAMES``.
    """
    low, high = np.array([BOUNDS[name] for name in names]).T
    first = np.clip([_get(start, name) for name in names], low, high)

    def of(x: FloatArray) -> Slip:
        return _with(start, dict(zip(names, x.tolist(), strict=True)))

    def off(x: FloatArray) -> FloatArray:
        grip = of(x)
        linear = data.linear(grip, which)
        return np.concatenate([data.residual(one, grip, linear) for one in which])

    if "grip" in names and not start.per_friction:
        is_grip, slips = np.array(names) == "grip", (0.0, *FIELD.start_slips)
        starts = [np.where(is_grip, one, first) for one in slips]
        first = min(starts, key=lambda x: float((off(x) ** 2).sum()))
        if first is starts[0]:
            return of(first)
    scale = _scales(names, first)

    def at(z: FloatArray) -> FloatArray:
        # Derivatives are taken by steps relative to z, which is 1 at the start.
        return np.asarray(np.clip(first + (z - 1.0) * scale, low, high))

    found = least_squares(
        lambda z: off(at(z)),
        np.ones(len(first)),
        bounds=(1.0 + (low - first) / scale - 1e-9, 1.0 + (high - first) / scale + 1e-9),
        x_scale=0.3,
        diff_step=FIELD.step,
        xtol=FIELD.tolerance,
        ftol=1e-4,
        max_nfev=FIELD.most_steps,
    )
    return of(at(found.x))


@dataclass(frozen=True, slots=True)
class FieldFit:
    """What the tracks of a session say of the gel, and how well they are explained.

    ``k_s``, ``decay`` and ``friction`` have standard errors by the scatter between presses, a
    1.96th of half the 95 % interval; ``friction`` is None where no slip shows, and then at least
    ``least_friction``. Errors and ``noise_mm`` are of one coordinate of a dot.
    """

    k_s: Estimate
    decay: Estimate
    friction: Estimate | None
    least_friction: float
    grip: Slip
    linear: FloatArray
    rmse_mm: float
    motion_mm: float
    noise_mm: float
    n_presses: int

    def summary(self) -> dict[str, Any]:
        """What ``--json`` prints."""
        estimates = {"k_s": self.k_s, "decay_mm": self.decay, "friction": self.friction}
        known = {
            name: None if one is None else {"value": one.value, "stderr": one.stderr}
            for name, one in estimates.items()
        }
        more = {"rmse_mm": self.rmse_mm, "motion_mm": self.motion_mm, "noise_mm": self.noise_mm}
        return {
            **known,
            "friction_at_least": self.least_friction,
            **more,
            "presses": self.n_presses,
        }

    def sentence(self) -> str:
        """The result in one line."""
        error = f"error {1e3 * self.rmse_mm:.2g} of {1e3 * self.motion_mm:.3g} µm RMS motion"
        mu = f"no slip shows: friction at least {self.least_friction:.2g}"
        if self.friction is not None:
            mu = f"friction {self.friction.value:.3f} ± {1.96 * self.friction.stderr:.2g}"
        return (
            f"shear field of {self.n_presses} presses: k_s {self.k_s.value:.4g} ± "
            f"{1.96 * self.k_s.stderr:.2g} mm/N, decay {self.decay.value:.3g} ± "
            f"{1.96 * self.decay.stderr:.2g} mm, {mu} (95 %); {error}, noise "
            f"{1e3 * self.noise_mm:.2g} µm"
        )


def fit_field(data: FieldData, log_k_s: Estimate | None = None) -> FieldFit:
    """Fit the field to all presses, with intervals by the scatter between them.

    Raises ``PressError`` where it explains nothing, or contradicts the k_s of the log's own sums.
    """
    which = range(len(data.presses))
    sticking = fit_slip(data, which, Slip(), ("decay",))
    names = ("decay", "grip")
    grip, linear, stderr = refined(data, fit_slip(data, which, sticking, names), names)
    per, per_stderr = grip.per_friction, stderr["grip"]
    if per <= 1.96 * per_stderr:  # no slip: the decay is as if there were none
        grip, linear, stderr = refined(data, sticking, ("decay",))
    pitch2 = data.tracks.pitch_mm**2
    friction = None
    if grip.per_friction > 0:
        friction = Estimate(grip.friction, per_stderr * grip.friction**2, "1")
    motions = np.concatenate([p.motion_mm[np.isfinite(p.motion_mm)] for p in data.presses])
    share, left = data.explained(grip, linear)
    found = FieldFit(
        k_s=Estimate(float(linear[0]) / pitch2, stderr["compliance"] / pitch2, "mm/N"),
        decay=Estimate(grip.decay_mm, stderr["decay"], "mm"),
        friction=friction,
        least_friction=1.0 / (per + 1.96 * per_stderr),
        grip=grip,
        linear=linear,
        rmse_mm=float(np.sqrt(left)),
        motion_mm=float(np.sqrt((motions**2).mean())),
        noise_mm=data.noise_mm,
        n_presses=len(data.presses),
    )
    k_s, wrong = found.k_s, ""
    if share < FIELD.least:
        wrong = f"it explains {max(share, 0.0):.0%} of the dots' motion"
    elif k_s.value <= 1.96 * k_s.stderr:
        wrong = "the interval of k_s holds 0"
    elif log_k_s is not None and abs(k_s.value - log_k_s.value) > max(
        FIELD.contradiction * log_k_s.value, 1.96 * (k_s.stderr + log_k_s.stderr)
    ):
        wrong = f"the log's own shear_x_mm and shear_y_mm give {log_k_s.value:.4g}"
    if wrong:
        msg = (
            f"{data.tracks.path}: {wrong}: {found.sentence()}; check the dots' axes, press and "
            "frame numbers, and forces, or calibrate without --markers"
        )
        raise PressError(msg)
    return found


def refined(
    data: FieldData, grip: Slip, names: Sequence[str]
) -> tuple[Slip, FloatArray, dict[str, float]]:
    """One Gauss–Newton step of all presses from ``grip`` on; and standard errors.

    ``names`` as of ``fit_slip``. Returns the parameters after the step, the linear ones, and the
    errors of both (``compliance``, ``dilation`` and ``names``) by the scatter between presses: a
    1.96th of half a 95 % interval.
    """
    which = range(len(data.presses))
    linear = data.linear(grip, which)
    x0 = np.array([_get(grip, name) for name in names])
    steps = FIELD.step * _scales(names, x0)
    breads, scores = [], []
    for index in which:
        columns, motion = data.rows(index, grip)
        slopes = []
        for name, value, step in zip(names, x0, steps, strict=True):
            low = max(value - step, BOUNDS[name][0])
            ends = [_with(grip, {name: one}) for one in (value + step, low)]
            up, down = (data.rows(index, one)[0] @ linear for one in ends)
            slopes.append((up - down) / (value + step - low))
        jacobian = np.column_stack([columns, *slopes])
        breads.append(jacobian.T @ jacobian)
        scores.append(jacobian.T @ (motion - columns @ linear))
    covariance, freedom = clustered(np.stack(scores), np.stack(breads))
    freedom = np.minimum(freedom, max(len(scores) - len(freedom), 1))
    errors = np.sqrt(np.diag(covariance)) * widened(freedom)
    found = dict(zip(("compliance", "dilation", *names), errors.tolist(), strict=True))
    step = np.linalg.pinv(np.sum(breads, axis=0), hermitian=True) @ np.sum(scores, axis=0)
    low_high = np.array([BOUNDS[name] for name in names]).T
    moved = np.clip(x0 + step[2:], *low_high)
    after = _with(grip, dict(zip(names, moved.tolist(), strict=True)))
    if (
        data.losses(after, data.linear(after, which), which).sum()
        < data.losses(grip, linear, which).sum()
    ):
        grip, linear = after, data.linear(after, which)
    return grip, linear, found


def _scales(names: Sequence[str], x: FloatArray) -> FloatArray:
    """How far parameters go at once: of slips their share, of lengths a multiple of a cell."""
    least = np.where((np.array(names) == "grip") & (x == 0.0), FIELD.first_slip_steps, 0.5)
    lengths = [5.0 if name in PLACE_NAMES[:3] else 0.0 for name in names]
    return np.maximum(np.maximum(np.abs(x), least), lengths)


def _get(grip: Slip, name: str) -> float:
    place = grip.place
    if name in ("decay", "grip") or place is None:
        return grip.decay_mm if name == "decay" else grip.per_friction
    values = (place.x_mm, place.y_mm, place.radius_mm, 1.0 / place.friction)
    return dict(zip(PLACE_NAMES, values, strict=True))[name]


def _with(grip: Slip, values: Mapping[str, float]) -> Slip:
    decay, per_friction = (values.get(one, _get(grip, one)) for one in ("decay", "grip"))
    place = grip.place
    if place is not None:
        x, y, radius, per = (values.get(one, _get(grip, one)) for one in PLACE_NAMES)
        place = Place(x, y, radius, 1.0 / max(per, 1.0 / STICKS))
    return Slip(decay, per_friction, place)


def arrow_figure(
    data: FieldData, grip: Slip, linear: FloatArray, beside_mm: FloatArray | float = 0.0
) -> Figure:
    """Measured motion, model and difference of a few presses, the worst explained first.

    ``beside_mm`` (M, 2) is by how much dots at rest are off where the model has them.
    """
    every = range(len(data.presses))
    ranked = np.argsort([-(data.residual(one, grip, linear) ** 2).mean() for one in every])
    rows = []
    drawn = np.linspace(0, len(ranked) - 1, FIELD.arrows).round().astype(int)
    for index in ranked[np.unique(drawn)]:
        press = data.presses[index]
        top = int(np.hypot(*press.force_n.T).argmax())
        model = linear[0] * data.strain(int(index), grip)[top] + linear[1] * press.dilation_mm[top]
        normal, shear = press.load["force_normal_n"], np.hypot(*press.force_n[top])
        title = f"press {press.number}, {normal:.1f} N, shear {shear:.1f} N"
        rows.append((title, data.tracks.rest_mm, press.motion_mm[top] + beside_mm, model))
    scale = data.sensor.mm_per_px
    return arrows(rows, (data.sensor.width_px * scale, data.sensor.height_px * scale))
