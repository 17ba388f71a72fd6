"""A grasp diagnosis as it stands in ``diagnosis.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tacgen.diagnose.contact.result import SCHEMA
from tacgen.diagnose.grasps.candidates import advice
from tacgen.diagnose.grasps.model_comparison import FALSE_ALARM, Standing, confusable
from tacgen.diagnose.grasps.result import MAX_FOLDS, GraspDiagnosis, describe


def diagnosis_record(
    diagnosis: GraspDiagnosis, absolute: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """The content of ``diagnosis.json``: the contract's keys and further ones.

    ``absolute`` maps an object to its declared values, by parameter (``mass_factor`` …): factors
    are then also given as what they come to.
    """
    n = len(diagnosis.real)
    effects = []
    for number, standing in enumerate(diagnosis.found):
        step = diagnosis.steps[number]
        second = step.standings[1] if len(step.standings) > 1 else None
        unsure = confusable(step.standings)
        effects.append(
            {
                "name": standing.name,
                "description": describe(standing),
                "parameters": _parameters(standing, absolute),
                "objects": list(_objects(standing)),
                "heldout_gain": diagnosis.rate_before - diagnosis.rate_after,
                "runner_up": second.name if second else "",
                "runner_up_log_evidence_behind": standing.gain - second.gain if second else None,
                "log_evidence_gain": standing.gain,
                "p_value": step.p_value,
                "or_value": standing.elsewhere,
                "confusable_with": list(unsure),
                "what_would_tell": [advice(standing.name, other) for other in unsure],
            }
        )
    return {
        "schema": SCHEMA,
        "notes": list(diagnosis.notes),
        "channels": {
            "grasp": {
                "verdict": diagnosis.verdict,
                "sentence": diagnosis.sentence,
                "effects": effects,
                "unexplained": [
                    {"covariate": d.covariate, "p_value": d.p_value} for d in diagnosis.dependences
                ]
                if diagnosis.too_many_left
                else [],
                "error_before": _error(diagnosis.rate_before, n),
                "error_after": _error(diagnosis.rate_after, n),
                "noise_floor": {
                    "rmse": diagnosis.n_left / n,
                    "how": "labels that no value of what was found matches",
                },
                "trials": {"fit": n, "test": n},
                "held_out": f"{min(MAX_FOLDS, n)} folds of {n} grasps; the whole choice made "
                "anew without each",
                "false_alarm_rate": FALSE_ALARM,
                "force_from_images": diagnosis.reading,
                "ranking": [
                    {
                        "candidate": s.name,
                        "log_evidence_gain": _number(s.gain),
                        "log_likelihood_gain": _number(s.fit),
                        "parameters": _parameters(s, absolute),
                        "objects": list(_objects(s)),
                    }
                    for s in diagnosis.steps[0].standings
                ],
                "p_value": diagnosis.steps[0].p_value,
                "steps": [
                    {
                        "chosen": step.taken,
                        "p_value": step.p_value,
                        "critical_gain": _number(step.critical_gain),
                        "candidates": [
                            {
                                "description": describe(standing),
                                "log_evidence_gain": _number(standing.gain),
                            }
                            for standing in step.standings
                        ],
                    }
                    for step in diagnosis.steps
                ],
            }
        },
    }


def _objects(standing: Standing) -> tuple[str, ...]:
    candidate = standing.hypothesis.candidate
    return candidate.objects if candidate is not None else ()


_ABSOLUTE = {
    "mass_factor": ("mass_kg", "kg"),
    "friction_factor": ("friction", "1"),
    "spinning_friction_factor": ("spinning_friction_mm", "mm"),
}


def _parameters(
    standing: Standing, absolute: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, Any]]:
    """The parameter, and for one object what its factor comes to."""
    candidate = standing.hypothesis.candidate
    if candidate is None:
        return {}
    key = candidate.parameter.key
    found = {
        key: {
            "value": _number(standing.value),
            "stderr": _number(standing.stderr),
            "unit": candidate.parameter.unit,
        }
    }
    if key in _ABSOLUTE and len(candidate.objects) == 1:
        name, unit = _ABSOLUTE[key]
        declared = absolute[candidate.objects[0]][key]
        found[name] = {
            "value": _number(declared * standing.value),
            "stderr": _number(declared * standing.stderr),
            "unit": unit,
        }
    return found


def _error(rate: float, n: int) -> dict[str, Any]:
    return {"rmse": rate, "nrmse": rate, "unit": "mislabel_rate", "mislabels": round(rate * n)}


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
