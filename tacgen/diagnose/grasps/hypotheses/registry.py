"""The one registry of hypotheses: what may be wrong with a simulated grasp, and how it acts.

Every module of this folder is imported, and those of hypotheses register them (``known``).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto

import numpy as np

from tacgen.collection.perturbed import Perturbation
from tacgen.core.errors import TacgenError
from tacgen.core.records import GraspObject
from tacgen.core.types import FloatArray


class Prediction(Enum):
    """How slip margins at a parameter's values follow from those as declared.

    ``FRICTION``, ``MASS``, ``FORCE`` and ``TORSION`` are factors with closed forms; they are
    simulated where a grasp is near its threshold.
    """

    NONE = auto()
    """Simulated at every node, interpolated in between."""
    FRICTION = auto()
    """The object's coefficient of friction."""
    MASS = auto()
    """The object's mass."""
    FORCE = auto()
    """The grip force."""
    TORSION = auto()
    """The moment that the pads hold."""
    EQUIVALENT_FORCE = auto()
    """Grasps move as at another grip force: none is simulated."""


@dataclass(frozen=True, slots=True)
class HypothesisParameter:
    """One number of a hypothesis.

    ``nodes`` are values at which outcomes are simulated or predicted, ascending, the declared one
    among them; the first and the last bound the search. ``spread`` is the prior standard deviation
    about the declared value, of the logarithm for a factor, and ``share`` the part of the
    hypothesis's prior weight. ``perturb`` gives the changes to the simulation that a value amounts
    to. ``changes_force``: whether the force between the pads changes, which images of imprints
    show. ``figure`` is the attribute of ``GraspObject`` that a factor multiplies, and its unit;
    ``limits`` gives the smallest and largest value that an object allows; ``sentence`` is how a
    value is reported, after the name and the objects.
    """

    key: str
    unit: str
    declared: float
    nodes: tuple[float, ...]
    spread: float
    perturb: Callable[[float], Perturbation]
    share: float = 1.0
    prediction: Prediction = Prediction.NONE
    changes_force: bool = False
    figure: tuple[str, str] | None = None
    limits: Callable[[GraspObject], tuple[float, float]] | None = None
    sentence: str = ""

    @property
    def is_factor(self) -> bool:
        """Whether the number multiplies what is declared."""
        return self.declared == 1.0

    @property
    def center(self) -> float:
        """The declared value on the axis of ``coordinate``."""
        return 0.0 if self.is_factor else self.declared

    def coordinate(self, values: FloatArray) -> FloatArray:
        """Values on the axis on which the prior is normal and outcomes are interpolated."""
        return np.log(values) if self.is_factor else np.asarray(values, dtype=np.float64)

    def value(self, coordinate: float) -> float:
        """The value at a place on that axis."""
        return math.exp(coordinate) if self.is_factor else coordinate

    def reported(self, value: str, error: str) -> str:
        """The value and its standard error in words."""
        usual = "at {} ± {} times the declared" if self.is_factor else "off by {} ± {} {}"
        return (self.sentence or usual).format(value, error, self.unit)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One thing that may be wrong, in one or several numbers.

    ``weight`` is its prior weight beside the others'; ``of_gripper`` says that it acts on every
    object (the gripper, or the table); ``separated_by`` what separates it for certain from another
    hypothesis, by that one's name.
    """

    name: str
    weight: float
    of_gripper: bool
    parameters: tuple[HypothesisParameter, ...]
    separated_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class HypothesisCandidate:
    """A parameter of a hypothesis, the objects whose grasps it acts on, and its prior weight."""

    hypothesis: Hypothesis
    parameter: HypothesisParameter
    objects: tuple[str, ...]
    weight: float

    @property
    def name(self) -> str:
        """Name of the hypothesis."""
        return self.hypothesis.name

    def acts_on(self, name: str) -> bool:
        """Whether grasps of the object ``name`` change, of objects not grasped yet too."""
        return self.hypothesis.of_gripper or name in self.objects

    @property
    def title(self) -> str:
        """The name and whose, such as ``mass of cup``."""
        whose = "" if self.hypothesis.of_gripper else f" of {', '.join(self.objects)}"
        return self.name + whose

    def reported(self, value: str, error: str) -> str:
        """The finding in words, such as ``grip_force at 0.80 ± 0.03 times the declared``."""
        return f"{self.title} {self.parameter.reported(value, error)}"


_REGISTRY: dict[str, Hypothesis] = {}


def register(hypothesis: Hypothesis) -> Hypothesis:
    """Add ``hypothesis`` to the registry.

    Raises ``TacgenError`` if its name is registered already.
    """
    if hypothesis.name in _REGISTRY:
        msg = f"the hypothesis {hypothesis.name!r} is registered twice; give one another name"
        raise TacgenError(msg)
    _REGISTRY[hypothesis.name] = hypothesis
    return hypothesis


def registered() -> tuple[Hypothesis, ...]:
    """Every hypothesis, the one with most prior weight first."""
    return tuple(sorted(_REGISTRY.values(), key=lambda one: (-one.weight, one.name)))


def candidates_for(objects: Sequence[str]) -> tuple[HypothesisCandidate, ...]:
    """Every candidate for grasps of these objects.

    What belongs to the gripper or the table acts on all of them. What belongs to an object is
    tried for each object alone and for all of them together, since a worn gel, a wrong habit of
    weighing or of placing touches all.
    """
    found = []
    for hypothesis in registered():
        sets = [tuple(objects)]
        if not hypothesis.of_gripper and len(objects) > 1:
            sets = [*((name,) for name in objects), tuple(objects)]
        for one in hypothesis.parameters:
            weight = hypothesis.weight * one.share / len(sets)
            found += [HypothesisCandidate(hypothesis, one, chosen, weight) for chosen in sets]
    return tuple(found)


def advice(name: str, other: str) -> str:
    """What separates two hypotheses for certain."""
    known = _REGISTRY[name].separated_by.get(other) or _REGISTRY[other].separated_by.get(name)
    return f"{name} or {other}: {known or 'grasps in which the two predict different outcomes'}"
