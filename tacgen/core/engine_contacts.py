"""Contact points as a physics engine gives them: one reader for each engine.

A grasp reads what touches its object, an attached sensor what touches its gel. Metres, N, world
axes.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

Part = TypeVar("Part")


class ContactPoint(NamedTuple, Generic[Part]):
    """A point at which something touches an object.

    ``part`` says what and where, as the reader's ``part_of`` has it; ``point_m`` is on the object
    where the engine gives a point on either body; ``normal`` points into the object. ``force_n`` is
    the whole force on the object, friction included, ``moment_n_m`` what friction holds beside it
    about the point: PyBullet does not report it.
    """

    part: Part
    point_m: Sequence[float]
    normal: Sequence[float]
    normal_force_n: float
    force_n: Sequence[float]
    moment_n_m: Sequence[float] = (0.0, 0.0, 0.0)


def bullet_points(
    raw: Iterable[Sequence[Any]],
    part_of: Callable[[tuple[int, int], tuple[int, int]], Part | None],
    *,
    near_m: float = 0.0,
) -> list[ContactPoint[Part]]:
    """Contact points of unfiltered ``getContactPoints``.

    ``part_of`` is asked of two bodies, each with its link: the ``part`` where the first is of the
    object and the second what touches it, else None. Points that do not press and are farther than
    ``near_m`` are left out.

    Unfiltered matters: with a filter PyBullet may swap the two bodies and turn the normal, but
    not the friction, whose sign is then lost. As it comes, both act on the first body.
    """
    points = []
    for _, first, second, first_link, second_link, on_first, on_second, *acting in raw:
        one, other = (first, first_link), (second, second_link)
        sign, point, part = 1.0, on_first, part_of(one, other)
        if part is None:
            sign, point, part = -1.0, on_second, part_of(other, one)
        (x, y, z), gap_m, push_n, along_n, (ax, ay, az), across_n, (bx, by, bz) = acting
        if part is None or (push_n == 0 and gap_m > near_m):
            continue
        normal = sign * x, sign * y, sign * z
        friction_n = (
            sign * (along_n * ax + across_n * bx),
            sign * (along_n * ay + across_n * by),
            sign * (along_n * az + across_n * bz),
        )
        force_n = tuple(push_n * n + f for n, f in zip(normal, friction_n, strict=True))
        points.append(ContactPoint(part, point, normal, push_n, force_n))
    return points


def mujoco_points(
    mujoco: Any, model: Any, data: Any, part_of: Callable[[int, int], Part | None]
) -> list[ContactPoint[Part]]:
    """Contact points of the last step; ``part_of`` as of ``bullet_points``, of two geoms.

    A contact of a soft body has the geom −1 there.
    """
    points, found, wrench = [], data.contact, np.zeros(6)
    geoms, places, frames = found.geom.tolist(), found.pos.tolist(), found.frame
    for k in np.flatnonzero(found.efc_address >= 0).tolist():
        first, second = geoms[k]
        # MuJoCo's normal, in the first row of the frame, and its force act on the second.
        sign, part = 1.0, part_of(second, first)
        if part is None:
            sign, part = -1.0, part_of(first, second)
        if part is None:
            continue
        mujoco.mj_contactForce(model, data, k, wrench)
        frame = sign * frames[k].reshape(3, 3)
        acting = (wrench[:3] @ frame).tolist(), (wrench[3:] @ frame).tolist()
        points.append(ContactPoint(part, places[k], frame[0].tolist(), float(wrench[0]), *acting))
    return points
