"""Whether a background is of the gel at rest of some presses: proven wrong, or odd."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.types import FloatArray
from tacgen.optics.dots import coarse, printed_dots
from tacgen.optics.drift import apart_grey
from tacgen.optics.same_view import alignment, other_view
from tacgen.presses.circles import Circle, change_in, drift_free_change, find_circle
from tacgen.presses.press_images import PressImages
from tacgen.presses.rules import IMAGES


def check_background(presses: PressImages) -> tuple[dict[int, str], list[str]]:
    """Which pictures are proven to be of another view or sensor than the background, and doubts.

    Raises ``PressError`` where the background is proven not to be of these presses' gel at rest,
    with what is wrong and the fix.
    """
    # What a camera clips in the presses is no other background.
    clipped = np.minimum(presses.background, presses.images.max())
    height, width = presses.shape_px
    size = (IMAGES.compared_width_px, max(8, round(IMAGES.compared_width_px * height / width)))
    rest = coarse(clipped, size, None)
    small = [coarse(image, size, None) for image in presses.images]
    apart = np.array([apart_grey(image, rest) for image in small])
    strangers: dict[int, str] = {}
    doubts: list[str] = []
    if len(presses) >= IMAGES.background_min_presses:
        doubts = _check_median(replace(presses, background=clipped), small, rest)
    factor, more = IMAGES.other_picture
    odd = np.nonzero(apart > factor * np.quantile(apart, 0.25) + more)[0]
    usual = np.argsort(apart)[: len(presses) // 2 + 1]
    lit = []
    for k in odd.tolist() if len(presses) >= IMAGES.min_presses else []:
        if wrong := other_view(presses.images[k], clipped):
            strangers[k] = f"does not match the background: {wrong}"
        elif alignment(presses.images[k], clipped).is_same:
            lit.append(k)
        elif _shows_texture(presses.images[usual], clipped):
            strangers[k] = "does not match the background: it is of another sensor or crop"
        else:
            lit.append(k)
    if lit:
        names = _names(presses, lit)
        doubts.append(
            f"the bare gel of {len(lit)} of {len(presses)} pictures differs from the background by "
            f"up to {apart[lit].max():.0f} grey levels, that of the others by "
            f"{np.median(apart):.0f} ({names}): other light, or another sensor; look at them"
        )
    if len(strangers) > len(presses) // 2:
        reasons = {strangers[k].partition(": ")[2] for k in strangers}
        count = f"{len(strangers)} of {len(presses)} pictures"
        msg = (
            f"{count} do not match the background ({_names(presses, list(strangers))}): "
            f"{'; '.join(sorted(reasons))}; save all pictures of one sensor as RGB, turned and "
            "cropped alike"
        )
        raise PressError(msg)
    return strangers, doubts


def _names(presses: PressImages, which: list[int]) -> str:
    names = ", ".join(presses.names[k] for k in which[:3])
    return names + (", …" if len(which) > 3 else "")


def _shows_texture(images: NDArray[np.uint8], background: NDArray[np.uint8]) -> bool:
    """Whether most of some pictures show the background's own fine texture."""
    return bool(np.median([alignment(image, background).is_same for image in images[:5]]))


def _check_median(presses: PressImages, small: list[FloatArray], rest: FloatArray) -> list[str]:
    """Doubts on the background beside the presses' median, which shows the bare gel.

    Raises ``PressError`` where it is proven to be of another view, gel or sensor, or a press.
    """
    median = np.median(small, axis=0).astype(np.float32)
    mismatch, (factor, more) = apart_grey(median, rest), IMAGES.other_background
    scatter = float(np.median([apart_grey(image, median) for image in small]))
    at_rest = np.asarray(np.median(presses.images, axis=0), dtype=np.uint8)
    if wrong := other_view(presses.background, at_rest):
        fix = "save all pictures as RGB, turned and cropped alike"
        msg = f"the background does not match the presses: {wrong}; {fix}"
        raise PressError(msg)
    if mismatch > factor * scatter + more:
        text = (
            f"the background does not match the presses: the bare gel differs by {mismatch:.0f} "
            f"grey levels after gain and offset, the presses among themselves by {scatter:.0f}; "
            "take it anew with the same gel, light and crop"
        )
        bare = np.median(np.abs(median - np.median(median, axis=(0, 1))), axis=(0, 1))
        unexplained = mismatch / max(float(np.median(bare)), 1e-9)
        is_other = unexplained > IMAGES.unexplained_share
        if is_other and not alignment(presses.background, at_rest).is_same:
            raise PressError(text)
        return [text]
    if printed_dots(presses.background) is not None:
        # They move with the gel, so that the median shows them elsewhere.
        return []
    return _contact_in_background(presses)


def _contact_in_background(presses: PressImages) -> list[str]:
    """A doubt where the background shows a contact as strong as the presses'.

    Where presses overlap, the median shows a faint contact too: only one as strong as theirs,
    while theirs lie elsewhere, is a press.

    Raises ``PressError`` where presses prove it that show the gel there alike.
    """
    chosen = presses.images[:: max(1, len(presses) // 15)]
    median = np.asarray(np.median(chosen, axis=0), dtype=np.uint8)
    place = find_circle(presses.background, median)
    if place.problem:
        return []
    found = [(find_circle(image, median), image) for image in chosen]
    seen = [(circle, image) for circle, image in found if not circle.problem]
    elsewhere = [
        np.hypot(*(circle.center_px - place.center_px)) > max(circle.radius_px, place.radius_px)
        for circle, _ in seen
    ]
    if not seen or np.mean(elsewhere) < IMAGES.moved_share:
        return []
    usual = float(np.median([change_in(image, median, circle) for circle, image in seen]))
    if change_in(presses.background, median, place) <= IMAGES.press_strength_share * usual:
        return []
    x, y = place.center_px
    away = np.stack([image for (_, image), far in zip(seen, elsewhere, strict=True) if far])
    if _alike_at_rest(away, presses.background, place) >= IMAGES.min_alike:
        fix = "it is a press itself; take it anew with nothing on the gel"
        msg = f"the background shows a contact at ({x:.0f}, {y:.0f}): {fix}"
        raise PressError(msg)
    fix = "look at it, and take it anew with nothing on the gel if it is a press"
    return [f"the background may show a contact at ({x:.0f}, {y:.0f}): {fix}"]


def _alike_at_rest(images: NDArray[np.uint8], background: NDArray[np.uint8], place: Circle) -> int:
    """How many pictures (N, H, W, 3) show the same gel in a circle and a contact elsewhere.

    Both other than the background; drift of the lamps is removed from each.
    """
    changes = np.stack([drift_free_change(image, background) for image in images])
    height, width = changes.shape[1:3]
    scale = width / background.shape[1]
    rows, columns = np.indices((height, width))
    x, y = (place.center_px + 0.5) * scale - 0.5
    distance = np.hypot(columns - x, rows - y) / (place.radius_px * scale)
    inside, beyond = changes[:, distance <= 1], changes[:, distance > IMAGES.beyond_place_radii]
    usual = np.median(inside, axis=0)
    is_alike = ((inside - usual) ** 2).sum(axis=(1, 2)) < IMAGES.alike_share * (usual**2).sum()
    here, there = (
        np.quantile(np.linalg.norm(part, axis=2), 0.99, axis=1) for part in (inside, beyond)
    )
    return int((is_alike & (there > IMAGES.own_strength_share * here)).sum())
