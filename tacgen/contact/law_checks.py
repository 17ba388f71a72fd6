"""What can be wrong with a contact law, or with the log it is asked to predict."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from tacgen.contact.effects import LoadHistory, find_effect
from tacgen.core.errors import ContactError

if TYPE_CHECKING:
    from tacgen.contact.law import ContactLaw, FittedEffect

LAWS = ("volume_linear", "linear_depth")


def law_problems(law: ContactLaw) -> list[str]:
    """Everything that is wrong with a law."""
    problems = []
    if law.law not in LAWS:
        problems.append(f"law = {law.law!r} is unknown; there are {', '.join(LAWS)}")
    if not (math.isfinite(law.k_n_mm3_per_n.value) and law.k_n_mm3_per_n.value > 0):
        problems.append(f"k_n_mm3_per_n = {law.k_n_mm3_per_n.value} is not a positive number")
    if not math.isnan(law.k_s_mm_per_n.value) and not law.k_s_mm_per_n.value > 0:
        problems.append(f"k_s_mm_per_n = {law.k_s_mm_per_n.value} is not a positive number")
    if law.law == "linear_depth":
        depth = law.k_depth_mm_per_n
        if depth is None or not (math.isfinite(depth.value) and depth.value > 0):
            problems.append("linear_depth needs a positive k_depth_mm_per_n (mm of depth per N)")
    seen = set()
    for index, fitted in enumerate(law.effects):
        where = f"effects[{index}] ({fitted.name})"
        if (fitted.channel, fitted.name) in seen:
            problems.append(f"{where} stands twice")
        seen.add((fitted.channel, fitted.name))
        problems += _effect_problems(where, fitted)
    return problems


def _effect_problems(where: str, fitted: FittedEffect) -> list[str]:
    try:
        effect = find_effect(fitted.channel, fitted.name)
    except ContactError as error:
        return [f"{where}: {error}"]
    problems = []
    for name, estimate in fitted.parameters.items():
        parameter = effect.parameter(name)
        if parameter is None:
            known = ", ".join(p.name for p in effect.parameters)
            problems.append(f"{where}: parameter {name!r} is unknown; there are {known}")
        elif math.isnan(estimate.value) or not (parameter.low <= estimate.value <= parameter.high):
            problems.append(
                f"{where}: {name} = {estimate.value:g} is not in "
                f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
            )
    return problems


def require_columns(law: ContactLaw, history: LoadHistory) -> None:
    """Raise a ``ContactError`` for columns that the law's effects need and the log lacks."""
    problems = []
    for fitted in law.effects:
        effect = find_effect(fitted.channel, fitted.name)
        lacking = [name for name in effect.needs if not history.has(name)]
        if lacking:
            problems.append(
                f"the law's effect {fitted.name!r} needs the column {', '.join(lacking)}, "
                "which the log lacks; add it, or predict with simulate=True to leave it neutral"
            )
    if problems:
        raise ContactError.from_problems(problems)
