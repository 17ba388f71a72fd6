"""Which presses can be used: circles are found where none are labelled, others dropped."""

from dataclasses import replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import BoolArray
from tacgen.core.errors import PressError
from tacgen.core.workers import map_in_processes
from tacgen.optics.dots import coarse, dots_in, printed_dots
from tacgen.optics.same_view import apart_grey, other_view
from tacgen.presses.circles import Circle, find_circle, outside_share
from tacgen.presses.experiments import experiments_of
from tacgen.presses.press_images import DroppedPress, PressImages

MIN_PRESSES = 3  # fewer cannot separate light from place

MAX_OUTSIDE = 0.25  # a contact may lie out of view by this share of its circle

MAX_SATURATED = 0.9  # of a contact's pixels at 0 or 255 in a channel where the gel is not
MAX_LABEL_SHARE = 1.5  # of the ball's radius, for a labelled one: people circle the gel's rim too
MAX_LABEL_OFF = 0.75  # radii from the circle that is seen: a label farther off is of something else
OWN_CHANGE_SHARE = 0.9  # of the seen circle's change: with it a labelled one is a contact anyway
MAX_CLIPPED = 0.5  # of a labelled circle at the camera's limit: beyond it only a part is seen
COMPARED_WIDTH_PX = 80  # of pictures compared with a background: light and crop show at any size

OTHER_PICTURE = 2.0, 1.5
"""A picture is of another sensor where its bare gel differs from the background, in grey levels, by
more than this many times the lower quartile of all pictures, and so many more. Within five measured
sets the factor is below 1.5, between any two of them above 2.5."""

OTHER_BACKGROUND = 1.6, 1.0
"""The same for the median of the presses against what single presses differ from it by: below 1.4
on the measured sets, above 1.6 for backgrounds cropped by a tenth to a fifth."""

BACKGROUND_MIN_PRESSES = 5  # a median of fewer pictures shows the contacts themselves
MOVED_SHARE = 0.4  # a background with a contact is a press if so many presses lie elsewhere
PRESS_STRENGTH = 0.3
"""And where its contact changes the picture at least this much of what theirs do: 0.04 for presses
that overlap, 0.45 to 3 for a press (rig and three real sensors)."""


def usable_presses(
    presses: PressImages, *, least: int = MIN_PRESSES, same_light: bool = True
) -> PressImages:
    """The presses that a fit or a score can use, each with a circle; the others are listed.

    Printed dots are found and masked. Pictures of one press are marked as one experiment. Without
    ``same_light`` the background may differ.

    Raises ``PressError`` if the background does not match the presses or pictures of fewer than
    ``least`` presses are left.
    """
    if same_light:
        _check_background(presses)
    presses = _with_dots_masked(presses)
    center, radius = presses.center_px.copy(), presses.radius_px.copy()
    found = ~presses.labelled
    copy_of = _first_alike(presses.images)
    seen_px = np.full((len(presses), 3), np.nan)
    dropped: list[DroppedPress] = []

    def circle_in(k: int) -> Circle:
        return find_circle(presses.images[k], presses.background, presses.hidden_in(k))

    for k, seen in enumerate(map_in_processes(circle_in, range(len(presses)))):
        circle = Circle(center[k], float(radius[k]))
        if not seen.problem and (found[k] or not _is_elsewhere(circle, seen)):
            seen_px[k] = [*seen.center_px, seen.radius_px]
        if found[k]:
            circle = seen
            center[k], radius[k] = circle.center_px, circle.radius_px
        reason, fix = circle.problem, "press again, with the ball well in view"
        if copy_of[k] != k:
            reason = f"is the same picture as {presses.names[copy_of[k]]}"
            fix = "list each press once"
        if not reason:
            reason, fix = _press_problem(presses, k, circle, labelled=not found[k])
        if not reason and not found[k]:
            reason, fix = _label_problem(presses, k, circle, seen)
        if reason:
            dropped.append(DroppedPress(presses.names[k], k + 2, reason, fix))
    keep = np.delete(np.arange(len(presses)), [press.row - 2 for press in dropped])
    marked = replace(presses, center_px=center, radius_px=radius, found=found, seen_px=seen_px)
    marked = replace(marked, experiment=experiments_of(marked)).select(keep)
    if marked.n_experiments < least:
        pictures = f" in {len(keep)} pictures" if len(keep) > marked.n_experiments else ""
        head = f"{marked.n_experiments} usable presses{pictures}, at least {least} are needed"
        head += "; press all over the gel"
        raise PressError.from_problems([head, *(str(press) for press in dropped)])
    warnings = presses.warnings
    if not np.ptp(presses.background, axis=2).any():
        grey = "the pictures are grey: slopes that are alike in brightness look the same"
        warnings += (f"{grey}; save them in colour",)
    dropped = [*presses.dropped, *dropped]
    return replace(marked, dropped=tuple(dropped), warnings=warnings)


def _with_dots_masked(presses: PressImages) -> PressImages:
    at_rest = printed_dots(presses.background)
    if at_rest is None:
        return presses
    hidden = np.stack([dots_in(image, at_rest) for image in presses.images])
    return replace(presses, dots=at_rest, hidden=hidden)


def _check_background(presses: PressImages) -> None:
    """Refuse pictures of two sensors, and a background that is not of these presses' gel at rest.

    Raises ``PressError`` with what is wrong and the fix.
    """
    # What a camera clips in the presses is no other background.
    presses = replace(presses, background=np.minimum(presses.background, presses.images.max()))
    height, width = presses.shape_px
    size = (COMPARED_WIDTH_PX, max(8, round(COMPARED_WIDTH_PX * height / width)))
    rest = coarse(presses.background, size, None)
    small = [coarse(image, size, None) for image in presses.images]
    apart = np.array([apart_grey(image, rest) for image in small])
    factor, more = OTHER_PICTURE
    other = np.nonzero(apart > factor * np.quantile(apart, 0.25) + more)[0]
    if MIN_PRESSES <= len(other) < len(presses):
        names = ", ".join(presses.names[k] for k in other[:3])
        fix = (
            "they are of another sensor, crop or light; keep the presses of one sensor in a folder"
        )
        count = f"{len(other)} of {len(presses)} pictures"
        msg = f"{count} do not match the background ({names}, …): {fix}"
        raise PressError(msg)
    if len(presses) < BACKGROUND_MIN_PRESSES:
        return
    median = np.median(small, axis=0).astype(np.float32)
    mismatch, (factor, more) = apart_grey(median, rest), OTHER_BACKGROUND
    scatter = float(np.median([apart_grey(image, median) for image in small]))
    if mismatch > factor * scatter + more:
        if wrong := other_view(rest, median):
            fix = "save all pictures as RGB, turned and cropped alike"
            msg = f"the background does not match the presses: {wrong}; {fix}"
            raise PressError(msg)
        msg = (
            f"the background does not match the presses: the bare gel differs by {mismatch:.0f} "
            f"grey levels after gain and offset, the presses among themselves by {scatter:.0f}; "
            "take it anew with the same gel, light and crop"
        )
        raise PressError(msg)
    if printed_dots(presses.background) is not None:
        # They move with the gel, so that the median shows them elsewhere.
        return
    _refuse_press_as_background(presses)


def _refuse_press_as_background(presses: PressImages) -> None:
    """Where presses overlap, the median shows a faint contact too: only one as strong as theirs,
    while theirs lie elsewhere, is a press.
    """
    chosen = presses.images[:: max(1, len(presses) // 15)]
    median = np.asarray(np.median(chosen, axis=0), dtype=np.uint8)
    place = find_circle(presses.background, median)
    if place.problem:
        return
    found = [(find_circle(image, median), image) for image in chosen]
    seen = [(circle, image) for circle, image in found if not circle.problem]
    elsewhere = [
        np.hypot(*(circle.center_px - place.center_px)) > max(circle.radius_px, place.radius_px)
        for circle, _ in seen
    ]
    if not seen or np.mean(elsewhere) < MOVED_SHARE:
        return
    usual = float(np.median([_change_in(image, median, circle) for circle, image in seen]))
    if _change_in(presses.background, median, place) > PRESS_STRENGTH * usual:
        x, y = place.center_px
        fix = "it is a press itself; take it anew with nothing on the gel"
        msg = f"the background shows a contact at ({x:.0f}, {y:.0f}): {fix}"
        raise PressError(msg)


def _press_problem(
    presses: PressImages, k: int, circle: Circle, *, labelled: bool
) -> tuple[str, str]:
    ball_px = presses.ball_radius_mm[k] / presses.mm_per_px
    source = "labelled" if labelled else "found"
    if circle.radius_px <= 1:
        return f"the {source} contact radius is {circle.radius_px:.1f} px", "correct the label"
    if circle.radius_px > MAX_LABEL_SHARE * ball_px:
        own = f"{MAX_LABEL_SHARE:g} times the ball's own {ball_px:.1f} px"
        reason = f"the {source} contact radius of {circle.radius_px:.1f} px is over {own}"
        return reason, "check the label, the ball's radius_mm and mm_per_px"
    outside = outside_share(circle.center_px, circle.radius_px, presses.shape_px)
    if outside > MAX_OUTSIDE:
        return f"{outside:.0%} of its contact lies out of view", "press farther from the edge"
    saturated = _saturated_share(presses, k, circle)
    if saturated > MAX_SATURATED:
        return f"{saturated:.0%} of its contact is saturated", "lower the exposure"
    if labelled and _change_in(presses.images[k], presses.background, circle) < 2.0:
        return "its labelled circle shows no contact", "correct the label or press again"
    return "", ""


def _is_elsewhere(label: Circle, seen: Circle) -> bool:
    apart = float(np.hypot(*(label.center_px - seen.center_px)))
    return apart > MAX_LABEL_OFF * max(seen.radius_px, label.radius_px)


def _label_problem(presses: PressImages, k: int, label: Circle, seen: Circle) -> tuple[str, str]:
    """What speaks against a labelled circle where another is clearly seen; empty if nothing."""
    if seen.problem or not _is_elsewhere(label, seen):
        return "", ""
    disc, step = _disc(label, presses.shape_px)
    clipped = presses.images[k, ::step, ::step][disc] == presses.images.max()
    if clipped.any(axis=1).mean() > MAX_CLIPPED:
        return "", ""
    own, other = (
        _change_in(presses.images[k], presses.background, circle) for circle in (label, seen)
    )
    if own > OWN_CHANGE_SHARE * other:
        return "", ""
    apart = float(np.hypot(*(label.center_px - seen.center_px)))
    x, y = seen.center_px
    reason = f"its labelled centre is {apart:.0f} px from the contact seen at ({x:.0f}, {y:.0f})"
    return reason, "correct center_x_px and center_y_px, or leave them empty"


def _first_alike(images: NDArray[np.uint8]) -> list[int]:
    first: dict[bytes, int] = {}
    return [first.setdefault(sha256(image.tobytes()).digest(), k) for k, image in enumerate(images)]


def _disc(circle: Circle, shape_px: tuple[int, int]) -> tuple[BoolArray, int]:
    """Pixels of a circle on a lattice that holds a thousand of them, and how wide that is."""
    step = max(1, int(circle.radius_px / 20))
    rows, columns = np.arange(0, shape_px[0], step)[:, None], np.arange(0, shape_px[1], step)
    x_px, y_px = circle.center_px
    return (columns - x_px) ** 2 + (rows - y_px) ** 2 <= circle.radius_px**2, step


def _saturated_share(presses: PressImages, k: int, circle: Circle) -> float:
    """Share of the circle's pixels at the end of the scale in at least one channel."""
    disc, step = _disc(circle, presses.shape_px)
    press, rest = (grey[::step, ::step][disc] for grey in (presses.images[k], presses.background))
    ends = ((press == 255) & (rest < 255)) | ((press == 0) & (rest > 0))
    return float(ends.any(axis=1).mean())


def _change_in(image: NDArray[np.uint8], rest: NDArray[np.uint8], circle: Circle) -> float:
    """How much more the circle differs from the gel at rest than the remaining image does."""
    disc, step = _disc(circle, rest.shape[:2])
    change = image[::step, ::step].astype(np.float32) - rest[::step, ::step]
    change = np.abs(change - np.median(change, axis=(0, 1))).mean(axis=2)
    return float(change[disc].mean() - np.median(change[~disc]))
