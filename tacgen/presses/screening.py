"""Which presses can be used: circles are found where none are labelled, others dropped."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import BoolArray
from tacgen.core.errors import PressError
from tacgen.presses.circles import Circle, find_circle, outside_share
from tacgen.presses.dots import dots_in, printed_dots
from tacgen.presses.press_images import DroppedPress, PressImages

MIN_PRESSES = 3

MAX_OUTSIDE = 0.25
"""A contact may lie out of view by this share of its circle."""

MAX_SATURATED = 0.9
"""Share of the contact's pixels that may be at 0 or 255 in a channel where the gel is not."""

MAX_LABEL_SHARE = 1.5
"""A labelled radius may exceed the ball's own by this factor: people circle the gel's rim too."""

MAX_LABEL_OFF = 0.75
"""A label farther than this from the circle that is seen, in radii, is of something else."""

MISMATCH_GREY = 40.0
"""A background this far from the median of the presses, over most of the picture, is not of the
same gel and light."""


def usable_presses(presses: PressImages, *, least: int = MIN_PRESSES) -> PressImages:
    """The presses that a fit or a score can use, each with a circle; the others are listed.

    Printed dots are found and masked.

    Raises
    ------
    PressError
        If the background does not match the presses or fewer than ``least`` are left.
    """
    _check_background(presses)
    presses = _with_dots_masked(presses)
    center, radius = presses.center_px.copy(), presses.radius_px.copy()
    found = ~presses.labelled
    copy_of = _first_alike(presses.images)
    seen_px = np.full((len(presses), 3), np.nan)
    dropped: list[DroppedPress] = []
    for k in range(len(presses)):
        seen = find_circle(presses.images[k], presses.background, presses.hidden_in(k))
        if not seen.problem:
            seen_px[k] = [*seen.center_px, seen.radius_px]
        circle = Circle(center[k], float(radius[k]))
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
            reason, fix = _label_problem(circle, seen)
        if reason:
            dropped.append(DroppedPress(presses.names[k], k + 2, reason, fix))
    bad = {press.row - 2 for press in dropped}
    keep = np.array([k for k in range(len(presses)) if k not in bad], dtype=int)
    if len(keep) < least:
        head = (
            f"{len(keep)} usable presses, at least {least} are needed; take more, spread over the "
            "whole gel"
        )
        raise PressError.from_problems([head, *(str(press) for press in dropped)])
    marked = replace(presses, center_px=center, radius_px=radius, found=found, seen_px=seen_px)
    return replace(
        marked.select(keep),
        dropped=(*presses.dropped, *dropped),
        warnings=(*presses.warnings, *_grey_warning(presses)),
    )


def _grey_warning(presses: PressImages) -> tuple[str, ...]:
    if np.ptp(presses.background, axis=2).any():
        return ()
    return (
        "the pictures are grey: slopes that are alike in brightness look the same; save "
        "them in colour",
    )


def _with_dots_masked(presses: PressImages) -> PressImages:
    at_rest = printed_dots(presses.background)
    if at_rest is None:
        return presses
    hidden = np.stack([dots_in(image, at_rest) for image in presses.images])
    return replace(presses, dots=at_rest, hidden=hidden)


def _check_background(presses: PressImages) -> None:
    median = np.median(presses.images[:: max(1, len(presses) // 15)], axis=0)
    # A quarter of the picture may be under a contact in every press.
    apart = float(np.quantile(np.abs(median - presses.background), 0.75))
    if apart > MISMATCH_GREY:
        msg = (
            f"the background is {apart:.0f} grey levels away from the median of the presses: it "
            "is not of the same gel and light; take it anew, just before the presses"
        )
        raise PressError(msg)


def _press_problem(
    presses: PressImages, k: int, circle: Circle, *, labelled: bool
) -> tuple[str, str]:
    """Why a press cannot be used and the fix; empty where it can."""
    ball_px = presses.ball_radius_mm[k] / presses.mm_per_px
    source = "labelled" if labelled else "found"
    if circle.radius_px <= 1:
        return f"the {source} contact radius is {circle.radius_px:.1f} px", "correct the label"
    if circle.radius_px > MAX_LABEL_SHARE * ball_px:
        return (
            f"the {source} contact radius of {circle.radius_px:.1f} px is over {MAX_LABEL_SHARE:g} "
            f"times the ball's own {ball_px:.1f} px",
            "check the label, the ball's radius_mm and mm_per_px",
        )
    outside = outside_share(circle.center_px, circle.radius_px, presses.shape_px)
    if outside > MAX_OUTSIDE:
        return f"{outside:.0%} of its contact lies out of view", "press farther from the edge"
    saturated = _saturated_share(presses, k, circle)
    if saturated > MAX_SATURATED:
        return f"{saturated:.0%} of its contact is saturated", "lower the exposure"
    if labelled and _change_in(presses, k, circle) < 2.0:
        return "its labelled circle shows no contact", "correct the label or press again"
    return "", ""


def _label_problem(label: Circle, seen: Circle) -> tuple[str, str]:
    """What speaks against a labelled circle where another is clearly seen; empty if nothing."""
    apart = float(np.hypot(*(label.center_px - seen.center_px)))
    if seen.problem or apart <= MAX_LABEL_OFF * max(seen.radius_px, label.radius_px):
        return "", ""
    x, y = seen.center_px
    return (
        f"its labelled centre is {apart:.0f} px from the contact seen at ({x:.0f}, {y:.0f})",
        "correct center_x_px and center_y_px, or leave them empty",
    )


def _first_alike(images: NDArray[np.uint8]) -> list[int]:
    """For each picture the first one with the same bytes."""
    first: dict[bytes, int] = {}
    return [first.setdefault(sha256(image.tobytes()).digest(), k) for k, image in enumerate(images)]


def _disc(circle: Circle, shape_px: tuple[int, int]) -> BoolArray:
    rows, columns = np.indices(shape_px)
    disc: BoolArray = (
        np.hypot(columns - circle.center_px[0], rows - circle.center_px[1]) <= circle.radius_px
    )
    return disc


def _saturated_share(presses: PressImages, k: int, circle: Circle) -> float:
    """Share of the circle's pixels at the end of the scale in at least one channel."""
    disc = _disc(circle, presses.shape_px)
    press, rest = presses.images[k][disc], presses.background[disc]
    ends = ((press == 255) & (rest < 255)) | ((press == 0) & (rest > 0))
    return float(ends.any(axis=1).mean())


def _change_in(presses: PressImages, k: int, circle: Circle) -> float:
    """How much more the circle differs from the background than the rest of the image does."""
    disc = _disc(circle, presses.shape_px)
    change = presses.images[k].astype(np.float32) - presses.background
    change = np.abs(change - np.median(change, axis=(0, 1))).mean(axis=2)
    return float(change[disc].mean() - np.median(change[~disc]))
