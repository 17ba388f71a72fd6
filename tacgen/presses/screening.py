"""Which presses can be used: circles are found where none are labelled, others dropped."""

from dataclasses import dataclass, replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.processes import map_in_processes
from tacgen.optics.dots import dots_in, printed_dots
from tacgen.presses.background_check import check_background
from tacgen.presses.circles import Circle, change_in, disc_of, find_circle, outside_share
from tacgen.presses.experiments import experiments_of
from tacgen.presses.press_images import DroppedPress, PressImages
from tacgen.presses.rules import IMAGES

LABEL_OR_PRESS = "label its circle, or press again with the ball well in view"


def usable_presses(
    presses: PressImages,
    *,
    least: int = IMAGES.min_presses,
    same_light: bool = True,
    every: bool = False,
) -> PressImages:
    """The presses that a fit or a score can use, each with a circle; the others are listed.

    A press is dropped where something certain speaks against it: no circle is known, its label
    contradicts the picture or the ball, its contact is saturated, it is of another view or sensor,
    or it is listed twice. What only looks odd becomes a warning. With ``every``, as for a score,
    each press that has a circle in view is kept, with a warning. Printed dots are found and masked.
    Pictures of one press are marked as one experiment. Without ``same_light`` the background may
    differ.

    Raises ``PressError`` if the background is proven not to be of these presses' gel at rest, or
    pictures of fewer than ``least`` presses are left.
    """
    strangers, doubts = check_background(presses) if same_light else ({}, [])
    presses = _with_dots_masked(presses)
    center, radius = presses.center_px.copy(), presses.radius_px.copy()
    found = ~presses.labelled
    copy_of = _first_alike(presses.images)
    seen_px = np.full((len(presses), 3), np.nan)
    dropped: list[DroppedPress] = []

    def circle_in(k: int) -> Circle:
        return find_circle(presses.images[k], presses.background, presses.hidden_in(k))

    for k, seen in enumerate(map_in_processes(circle_in, range(len(presses)))):
        judged = _judged(presses, k, seen, every=every)
        circle, found[k] = judged.circle, judged.found
        if not seen.problem and (found[k] or not _is_elsewhere(circle, seen)):
            seen_px[k] = [*seen.center_px, seen.radius_px]
        center[k], radius[k] = circle.center_px, circle.radius_px
        reason, fix = judged.reason, judged.fix
        if copy_of[k] != k:
            reason = f"is the same picture as {presses.names[copy_of[k]]}"
            fix = "list each press once"
        elif k in strangers:
            reason, fix = strangers[k], "keep the presses of one sensor, saved alike, in a folder"
        if reason:
            dropped.append(DroppedPress(presses.names[k], k + 2, reason, fix))
        else:
            doubts += [f"{presses.names[k]} (row {k + 2}): {doubt}" for doubt in judged.doubts]
    keep = np.delete(np.arange(len(presses)), [press.row - 2 for press in dropped])
    marked = replace(presses, center_px=center, radius_px=radius, found=found, seen_px=seen_px)
    marked = replace(marked, experiment=experiments_of(marked)).select(keep)
    if marked.n_experiments < least:
        pictures = f" in {len(keep)} pictures" if len(keep) > marked.n_experiments else ""
        head = f"{marked.n_experiments} usable presses{pictures}, at least {least} are needed"
        head += "; press all over the gel"
        raise PressError.from_problems([head, *(str(press) for press in dropped)])
    if not np.ptp(presses.background, axis=2).any():
        grey = "the pictures are grey: slopes that are alike in brightness look the same"
        doubts.append(f"{grey}; save them in colour")
    all_dropped = (*presses.dropped, *dropped)
    return replace(marked, dropped=all_dropped, warnings=(*presses.warnings, *doubts))


@dataclass(frozen=True, slots=True)
class _Judged:
    """The circle of a press, whether it is found or labelled, and what speaks against the press."""

    circle: Circle
    found: bool
    reason: str
    fix: str
    doubts: tuple[str, ...]


def _judged(presses: PressImages, k: int, seen: Circle, *, every: bool) -> _Judged:
    found = not presses.labelled[k]
    circle, reason, fix = seen, seen.problem, LABEL_OR_PRESS
    doubts = []
    if not found:
        circle = Circle(presses.center_px[k], float(presses.radius_px[k]))
        reason, fix = _label_problem(presses, k, circle, seen)
        if reason and not seen.problem:
            doubts.append(f"{reason}; the circle that is seen is taken: {fix}")
            found, circle, reason = True, seen, ""
    if not reason:
        reason, fix = _press_problem(presses, k, circle)
    known = bool(np.isfinite([*circle.center_px, circle.radius_px]).all())
    outside = outside_share(circle.center_px, circle.radius_px, presses.shape_px) if known else 1.0
    if reason and every and outside < 1.0 and circle.radius_px > 1:
        doubts.append(f"{reason}; counted all the same: {fix}")
        reason = ""
    if outside > IMAGES.max_outside_share:
        doubts.append(f"{outside:.0%} of its contact lies out of view")
    return _Judged(circle, found, reason, fix, tuple(doubts))


def _with_dots_masked(presses: PressImages) -> PressImages:
    at_rest = printed_dots(presses.background)
    if at_rest is None:
        return presses
    hidden = np.stack([dots_in(image, at_rest) for image in presses.images])
    return replace(presses, dots=at_rest, hidden=hidden)


def _press_problem(presses: PressImages, k: int, circle: Circle) -> tuple[str, str]:
    """What certainly speaks against a press with this circle, and the fix; empty if nothing."""
    if reason := _size_problem(presses, k, circle.radius_px):
        return f"the contact {reason}", "check the ball's radius_mm and mm_per_px"
    saturated = _saturated_share(presses, k, circle)
    if saturated > IMAGES.max_saturated_share:
        return f"{saturated:.0%} of its contact is saturated", "lower the exposure"
    return "", ""


def _size_problem(presses: PressImages, k: int, radius_px: float) -> str:
    ball_px = presses.ball_radius_mm[k] / presses.mm_per_px
    if radius_px <= 1:
        return f"radius is {radius_px:.1f} px"
    if radius_px > IMAGES.max_label_balls * ball_px:
        own = f"{IMAGES.max_label_balls:g} times the ball's own {ball_px:.1f} px"
        return f"radius of {radius_px:.1f} px is over {own}"
    return ""


def _is_elsewhere(label: Circle, seen: Circle) -> bool:
    apart = float(np.hypot(*(label.center_px - seen.center_px)))
    return apart > IMAGES.max_label_off_radii * max(seen.radius_px, label.radius_px)


def _label_problem(presses: PressImages, k: int, label: Circle, seen: Circle) -> tuple[str, str]:
    """In what a labelled circle contradicts the picture or the ball; empty if in nothing."""
    fix = "correct center_x_px and center_y_px, or leave them empty"
    if reason := _size_problem(presses, k, label.radius_px):
        return f"the labelled contact {reason}", "check the label, radius_mm and mm_per_px"
    if outside_share(label.center_px, label.radius_px, presses.shape_px) == 1.0:
        return "its labelled circle lies out of view", fix
    change = change_in(presses.images[k], presses.background, label)
    if seen.problem:
        is_empty = change < IMAGES.least_change_grey
        return ("its labelled circle shows no contact", fix) if is_empty else ("", "")
    if not _is_elsewhere(label, seen):
        return "", ""
    disc, step = disc_of(label, presses.shape_px)
    clipped = presses.images[k, ::step, ::step][disc] == presses.images.max()
    own_change = change > IMAGES.own_change_share * change_in(
        presses.images[k], presses.background, seen
    )
    if own_change or clipped.any(axis=1).mean() > IMAGES.max_clipped_share:
        return "", ""
    apart = float(np.hypot(*(label.center_px - seen.center_px)))
    x, y = seen.center_px
    return f"its labelled centre is {apart:.0f} px from the contact seen at ({x:.0f}, {y:.0f})", fix


def _first_alike(images: NDArray[np.uint8]) -> list[int]:
    first: dict[bytes, int] = {}
    return [first.setdefault(sha256(image.tobytes()).digest(), k) for k, image in enumerate(images)]


def _saturated_share(presses: PressImages, k: int, circle: Circle) -> float:
    """Share of the circle's pixels at the end of the scale in at least one channel."""
    disc, step = disc_of(circle, presses.shape_px)
    press, rest = (grey[::step, ::step][disc] for grey in (presses.images[k], presses.background))
    ends = ((press == 255) & (rest < 255)) | ((press == 0) & (rest > 0))
    return float(ends.any(axis=1).mean())
