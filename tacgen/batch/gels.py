"""What the gels of a batch are asked for, and what they remember of a contact law's effects."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel_response import GelCourse, GelLoad, gel_load, gel_loads
from tacgen.contact.law import ContactLaw
from tacgen.core.records import ContactFrame
from tacgen.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class Loads:
    """The loads of one call on all gels.

    ``law`` is theirs and ``plain`` what all loads have in common; ``force_n`` (N,) is the force
    into each gel, ``pulls`` (N, 3) those along x and y and the moment
    about its normal, N·mm. ``normal`` (N,) is the volume that the law makes of it, mm³, or TACTO's
    δ, mm, ``shear_sum_mm`` (N, 2) the sum of the markers' motion. Gels ``is_new`` (N,) are at rest
    before it; without ``keeps`` all are after it. ``is_sheared`` where anything pulls, or did.
    """

    law: ContactLaw
    plain: GelLoad
    force_n: FloatArray
    pulls: FloatArray
    normal: FloatArray
    shear_sum_mm: FloatArray
    is_new: NDArray[np.bool_]
    keeps: bool
    is_sheared: bool

    @property
    def slides(self) -> NDArray[np.bool_]:
        """Whether more is asked for than friction holds, (N,)."""
        return np.asarray(np.hypot(*self.pulls[:, :2].T) > self.plain.friction * self.force_n)

    def of(self, world: int) -> GelLoad:
        """The load of one gel."""
        x, y, turn = self.pulls[world].tolist()
        force_n, at_rest = float(self.force_n[world]), np.eye(4)
        frame = ContactFrame(0.0, force_n, np.array([x, y]), turn, at_rest)
        return gel_load(self.law, frame, float(self.normal[world]), self.shear_sum_mm[world])


class Gels:
    """The gels of N worlds under one contact law."""

    def __init__(self, law: ContactLaw, n: int) -> None:
        self.law, self._n = law, n
        self._is_plain = not (law.effects or law.collision_margin_mm)  # a factor on the force
        self._courses = [] if self._is_plain else [GelCourse(law) for _ in range(n)]
        self._last_s, self._is_new = np.full(n, -np.inf), np.ones(n, bool)
        self._may_be_sheared = False
        at_rest = ContactFrame(0.0, 0.0, np.zeros(2), 0.0, np.eye(4))
        self.plain = gel_load(law, at_rest, 0.0, np.zeros(2))  # what all loads have in common

    def history(self) -> tuple[Any, ...]:
        """What the gels remember, for ``take_back``."""
        courses = [copy(course) for course in self._courses]
        return self._last_s.copy(), self._is_new.copy(), courses, self._may_be_sheared

    def take_back(self, history: tuple[Any, ...]) -> None:
        """Remember what they did then."""
        self._last_s, self._is_new, self._courses, self._may_be_sheared = history

    def begin(self, worlds: Sequence[int] | NDArray[np.integer[Any]]) -> None:
        """A new press, of a gel at rest, in some worlds."""
        worlds = np.asarray(worlds, int)
        self._last_s[worlds], self._is_new[worlds] = -np.inf, True
        for world in worlds if self._courses else ():
            self._courses[world].begin()

    def loads(self, force_n: FloatArray, pulls: FloatArray, time_s: FloatArray | None) -> Loads:
        """What the law makes of the forces.

        Without the worlds' clocks (N,), or where one goes back, a new press begins.
        """
        if time_s is None:
            self.begin(range(self._n))
        else:
            self.begin(np.flatnonzero(time_s < self._last_s))
            self._last_s[:] = time_s
        normal, shear_mm = self._responses(force_n, pulls[:, :2], time_s)
        is_sheared = bool(pulls.any()) or (time_s is not None and self._may_be_sheared)
        is_new, keeps = self._is_new.copy(), time_s is not None
        if is_sheared:
            self._may_be_sheared = keeps
            self._is_new[:] = False
        return Loads(
            self.law, self.plain, force_n, pulls, normal, shear_mm, is_new, keeps, is_sheared
        )

    def _responses(
        self, force_n: FloatArray, shear_n: FloatArray, time_s: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        law, k_s = self.law, self.plain.k_s_mm_per_n
        if self._is_plain:
            is_depth = law.law == "linear_depth"
            factor = law.k_depth_mm_per_n if is_depth else law.k_n_mm3_per_n
            return (factor.value if factor is not None else 0.0) * force_n, k_s * shear_n
        found: list[GelLoad] = []
        for course, force, shear, at_s in zip(
            self._courses,
            force_n,
            shear_n,
            np.zeros(self._n) if time_s is None else time_s,
            strict=True,
        ):
            frame = ContactFrame(at_s, force, shear, 0.0, np.eye(4))
            one = gel_loads(law, [frame])[0] if time_s is None else course.load(frame, 0.0)
            found.append(one)
        normal = [one.indentation_mm if one.volume_mm3 is None else one.volume_mm3 for one in found]
        sums_mm = [np.asarray(one.shear_sum_mm, np.float64) for one in found]
        return np.array(normal, np.float64), np.array(sums_mm)
