"""What the presses say about mm/px and about the balls: rulers, a bound, and ratios of radii.

A ball's slope is r/R on its sine, so a picture of a ball tells its radius in pixels only up to a
factor: with every length 10 % larger the same slopes would just be called by other names, and the
table would absorb it. That stays so with several balls; what two balls do tell is the ratio of
their radii, because equal slopes look equal. The scale itself needs a ruler: places of the presses
that a stage has logged, or printed dots of known pitch. Without one there is a bound: no contact is
wider than its ball.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from tacgen.calibrate.lookup.model_choice import fold_of, held_out_squares
from tacgen.calibrate.lookup.prepared import PreparedPresses
from tacgen.calibrate.lookup.press_fit import JointFit, place_jointly, press_sums
from tacgen.calibrate.lookup.settings import RULES, SMOOTH_WITH_DRIFT
from tacgen.core.types import FloatArray
from tacgen.optics.dots import find_spots, nearest_px
from tacgen.presses.experiments import per_experiment
from tacgen.presses.press_images import PressImages


@dataclass(frozen=True, slots=True)
class Ruler:
    """An estimate of mm/px and what it rests on."""

    name: str
    mm_per_px: float
    stderr: float
    n: int


@dataclass(frozen=True, slots=True)
class BallRatio:
    """By what factor a ball looks larger than its stated radius, the reference ball being right."""

    radius_mm: float
    reference_mm: float
    factor: float
    stderr: float


@dataclass(frozen=True, slots=True)
class Stretch:
    """mm/px along the picture's columns over that along its rows, by the stage's places."""

    factor: float
    stderr: float


@dataclass(frozen=True, slots=True)
class ScaleEvidence:
    """All that is known of the scale; ``warnings`` are disagreements, ``notes`` what is open."""

    stated_mm_per_px: float
    rulers: tuple[Ruler, ...]
    largest_mm_per_px: float
    ratios: tuple[BallRatio, ...]
    stretch: Stretch | None
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def estimate(self) -> Ruler | None:
        """The rulers together, weighted by their errors; None without one."""
        if not self.rulers:
            return None
        weight = np.array([1.0 / ruler.stderr**2 for ruler in self.rulers])
        value = np.array([ruler.mm_per_px for ruler in self.rulers])
        mean = float((weight * value).sum() / weight.sum())
        names = " and ".join(ruler.name for ruler in self.rulers)
        return Ruler(names, mean, float(weight.sum() ** -0.5), sum(r.n for r in self.rulers))

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for a table's provenance and for ``--json``."""
        together = self.estimate
        return {
            "stated_mm_per_px": self.stated_mm_per_px,
            "estimate_mm_per_px": together.mm_per_px if together else None,
            "stderr_mm_per_px": together.stderr if together else None,
            "rulers": [asdict(ruler) for ruler in self.rulers],
            "largest_mm_per_px": self.largest_mm_per_px,
            "ball_ratios": [asdict(ratio) for ratio in self.ratios],
        }


def scale_evidence(prepared: PreparedPresses, fit: JointFit) -> ScaleEvidence:
    """What presses placed as in ``fit`` tell about mm/px and the balls' radii."""
    presses = prepared.presses
    candidates = (by_stage(presses, fit), by_dots(presses))
    rulers = tuple(ruler for ruler in candidates if ruler is not None)
    largest = largest_scale(presses)
    ratios = ball_ratios(prepared, fit)
    stretch = stretch_by_stage(presses, fit)
    found = ScaleEvidence(presses.mm_per_px, rulers, largest, ratios, stretch, (), ())
    return replace(
        found, warnings=tuple(_warnings(presses, found)), notes=tuple(_notes(presses, found))
    )


def _stage_and_places(presses: PressImages, fit: JointFit) -> tuple[FloatArray, FloatArray] | None:
    """Places of presses (E, 2) about their middle: mm by the stage, px in the pictures."""
    if presses.stage_mm is None:
        return None
    known = np.isfinite(presses.stage_mm).all(axis=1)
    each = presses.experiment[known]
    if len(np.unique(each)) < RULES.min_ruler_presses:
        return None
    stage = per_experiment(presses.stage_mm[known], each)
    place = per_experiment(fit.geometry[known, :2], each) / presses.mm_per_px
    return stage - stage.mean(axis=0), place - place.mean(axis=0)


def stretch_by_stage(presses: PressImages, fit: JointFit) -> Stretch | None:
    """By how much a picture's pixels are no squares, whatever the stage's axes are turned by."""
    places = _stage_and_places(presses, fit)
    if places is None:
        return None
    stage, place = places
    inverse = np.linalg.pinv(stage.T @ stage)
    if (
        len(stage) < RULES.min_ruler_presses + 1
        or np.linalg.cond(stage.T @ stage) > RULES.max_condition
    ):
        return None
    px_per_mm = inverse @ stage.T @ place  # (2, 2): the column of a picture's axis
    left = place - stage @ px_per_mm
    variance = float((left**2).sum()) / (2 * len(stage) - 6)
    size = np.linalg.norm(px_per_mm, axis=0)
    if not size.min() > 0:
        return None
    shares = [
        variance * float(axis @ inverse @ axis) / length**4
        for axis, length in zip(px_per_mm.T, size, strict=True)
    ]
    factor = float(size[1] / size[0])
    return Stretch(factor, factor * float(np.sqrt(sum(shares) + 2 * RULES.uneven_light_share**2)))


def by_stage(presses: PressImages, fit: JointFit) -> Ruler | None:
    """mm/px from where a stage says the presses were, against where they are in the pictures.

    The axes may be turned or mirrored against the picture's: only distances count.
    """
    places = _stage_and_places(presses, fit)
    if places is None:
        return None
    stage, place = (each @ np.array([1.0, 1.0j]) for each in places)
    power = float((np.abs(stage) ** 2).sum())
    if power <= 0:
        return None
    px_per_mm = max(abs(np.vdot(axes, place)) for axes in (stage, stage.conj())) / power
    if px_per_mm <= 0:
        return None
    left = max(float((np.abs(place) ** 2).sum()) - px_per_mm**2 * power, 0.0)
    scatter = np.sqrt(left / (2 * len(place) - 4) / power) / px_per_mm
    middle, either = _of_contact_or_ball(presses)
    value = middle / px_per_mm
    error = value * float(np.sqrt(scatter**2 + RULES.uneven_light_share**2 + either**2))
    return Ruler("the stage's places", value, error, len(place))


def _of_contact_or_ball(presses: PressImages) -> tuple[float, float]:
    """Factor from a stage's distances to those of the contacts, and how far it is open.

    On a flat gel 1. On a dome a ball touches beside its own centre, nearer to the dome's middle by
    the share R/(R + dome); whether the stage's places are the ball's or the contact's is not known.
    """
    if presses.dome_radius_mm <= 0:
        return 1.0, 0.0
    ball = float(presses.ball_radius_mm.mean())
    nearer = presses.dome_radius_mm / (presses.dome_radius_mm + ball)
    return (1 + nearer) / 2, (1 - nearer) / 2


def by_dots(presses: PressImages) -> Ruler | None:
    """mm/px from the spacing of printed dots of known pitch."""
    if presses.dots is None or not presses.dot_pitch_mm > 0:
        return None
    spots = find_spots(presses.background)
    nearest = nearest_px(spots.places_px[spots.alike])
    spacing = float(np.median(nearest))
    usual = nearest[np.abs(nearest - spacing) < 0.2 * spacing]
    error = 1.25 * usual.std() / np.sqrt(len(usual)) + 0.002 * spacing
    scale = presses.dot_pitch_mm / spacing
    return Ruler("the printed dots", scale, float(scale * error / spacing), len(usual))


def largest_scale(presses: PressImages) -> float:
    """The largest mm/px at which every contact is no wider than its ball."""
    if presses.seen_px is None or not np.isfinite(presses.seen_px[:, 2]).any():
        return float("inf")
    bounds = presses.ball_radius_mm * RULES.rim_excess / presses.seen_px[:, 2]
    # The widest tenth, so that one misread circle does not set the bound.
    return float(np.nanquantile(bounds, 0.1))


def ball_ratios(prepared: PreparedPresses, fit: JointFit) -> tuple[BallRatio, ...]:
    """How large each ball looks against the ball that pressed most often."""
    each = per_experiment(prepared.presses.ball_radius_mm, prepared.presses.experiment)
    radii, counts = np.unique(each, return_counts=True)
    reference = radii[np.argmax(counts)]
    return tuple(
        _ratio(prepared, fit, float(radius), float(reference))
        for radius, count in zip(radii, counts, strict=True)
        if radius != reference and count >= RULES.min_ratio_presses
    )


def _ratio(prepared: PreparedPresses, fit: JointFit, radius: float, reference: float) -> BallRatio:
    """Profile of the held-out error over the ball's radius; scatter by bootstrap over presses."""
    stated = prepared.presses.ball_radius_mm
    profile = []
    for factor in RULES.radius_factors:
        balls = np.where(stated == radius, factor * radius, stated)
        presses = replace(prepared.presses, ball_radius_mm=balls)
        profile.append(_squares(replace(prepared, presses=presses), fit))
    squares = per_experiment(np.array(profile).T, prepared.presses.experiment).T
    count = squares.shape[1]
    rng = np.random.default_rng(count)
    draws = [rng.integers(0, count, count) for _ in range(RULES.bootstraps)]
    factors = [_lowest(squares[:, draw].sum(axis=1)) for draw in draws]
    return BallRatio(radius, reference, _lowest(squares.sum(axis=1)), float(np.std(factors)))


def _squares(prepared: PreparedPresses, fit: JointFit) -> FloatArray:
    """Squared error (N,) of each press by a model of the others, all placed anew."""
    background = prepared.backgrounds[SMOOTH_WITH_DRIFT]
    placed = place_jointly(prepared, background, RULES.ratio_settings, start=fit, iterations=3)
    samples = prepared.samples(background, RULES.pixels_for_ratio)
    sums = [
        press_sums(sample, place, placed.press_model, RULES.ratio_settings, sample.change)
        for sample, place in zip(samples, placed.geometry, strict=True)
    ]
    folds = fold_of(prepared.presses.experiment)
    return held_out_squares(sums, folds, RULES.ratio_settings)[:, 0]


def _lowest(squares: FloatArray) -> float:
    """Where a parabola through the profile is lowest, within the factors that were tried."""
    factors = np.array(RULES.radius_factors)
    middle = int(np.clip(np.argmin(squares), 1, len(factors) - 2))
    near = slice(middle - 1, middle + 2)
    bend, slope, _ = np.polyfit(factors[near] - factors[middle], squares[near], 2)
    if bend <= 0:
        return float(factors[np.argmin(squares)])
    step = np.clip(-slope / (2 * bend), -0.05, 0.05)
    return float(factors[middle] + step)


def _warnings(presses: PressImages, found: ScaleEvidence) -> list[str]:
    stated = found.stated_mm_per_px
    lines = []
    for ruler in found.rulers:
        apart = ruler.mm_per_px / stated - 1
        if abs(apart) > max(RULES.clear_share, RULES.clear_sigmas * ruler.stderr / stated):
            lines.append(
                f"the stated mm_per_px is {stated:.4f}, but {ruler.name} say {ruler.mm_per_px:.4f} "
                f"± {ruler.stderr:.4f} ({apart:+.0%}): check both; --mm-per-px "
                f"{ruler.mm_per_px:.4f} sets the scale"
            )
    if found.stretch is not None:
        apart, error = found.stretch.factor - 1, found.stretch.stderr
        if abs(apart) > max(RULES.clear_share, RULES.clear_sigmas * error):
            lines.append(
                f"by the stage's places, a pixel is {found.stretch.factor:.3f} ± {error:.3f} times "
                "as wide as high: the pictures were stretched, or x_mm or y_mm is in another "
                "scale; resize them so that pixels are squares, or correct x_mm and y_mm"
            )
    if stated > found.largest_mm_per_px:
        lines.append(
            f"at {stated:.4f} mm/px contacts are wider than their ball; that cannot be above "
            f"{found.largest_mm_per_px:.4f} mm/px: mm_per_px is too large or the ball's radius_mm "
            "too small"
        )
    labelled = presses.radius_px[~presses.found]
    beyond = int((labelled * stated > presses.ball_radius_mm[~presses.found]).sum())
    if beyond:
        lines.append(
            f"{beyond} of {len(labelled)} labelled contact radii exceed the ball's own radius: the "
            "labels follow the gel's dark rim, or mm_per_px or radius_mm is off; the radii were "
            "estimated instead"
        )
    for ratio in found.ratios:
        apart = ratio.factor - 1
        if abs(apart) > max(RULES.clear_share, RULES.clear_sigmas * ratio.stderr):
            lines.append(
                f"the ball of {ratio.radius_mm:g} mm looks like one of "
                f"{ratio.factor * ratio.radius_mm:.2f} ± {ratio.stderr * ratio.radius_mm:.2f} mm "
                f"if the one of {ratio.reference_mm:g} mm is right: measure both"
            )
    return lines


def _notes(presses: PressImages, found: ScaleEvidence) -> list[str]:
    lines = []
    if not found.rulers:
        lines.append(
            "nothing in these presses measures the scale, so the stated mm_per_px is used; it "
            f"cannot be above {found.largest_mm_per_px:.4f}, where contacts would be wider than "
            "their ball. A stage's x_mm and y_mm in presses.csv, or printed dots with "
            "markers.pitch_mm in sensor.yaml, would measure it"
        )
    if len(set(presses.ball_radius_mm.tolist())) == 1:
        lines.append(
            "one ball only: an error of its radius cannot be detected; presses of a second ball "
            "of another size would show it"
        )
    return lines
