"""Forward selection of optical effects over whole presses, and what could not be told apart."""

from __future__ import annotations

from dataclasses import dataclass, replace

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.candidates import candidates
from tacgen.diagnose.optics.fit import Problem
from tacgen.diagnose.optics.model import Optics
from tacgen.diagnose.optics.model_comparison import Contest, Entry, gain_p_value, is_as_good
from tacgen.diagnose.optics.residuals import left_over

FALSE_ALARM = 0.01
"""Chance, over all candidates, of taking an effect on presses that have none."""

LEAST_GAIN = 0.05
"""And an effect must lower the error by this share, or it is not worth having."""

LEAST_EFFECT = 0.5
"""And what it changes must stand out of the camera's noise, RMS."""

LEAST_STRETCH = 1.0
"""More is asked of a scale and of centres: both can bend to the errors of form that a table's
polynomial and a skin leave around every contact, on presses without any effect."""

LEAST_GAIN_PILED = 0.01
"""Where the brightest values pile up the camera clips, whatever a table can hide of that."""

MOST_EFFECTS = 5

OUTSIDE = ("place_on_gel", "image_number")
"""What no effect of the list follows by itself."""

FINALISTS = 3
"""The best candidates of a step are fitted to the end before they are compared."""


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the selection: the error before it and with each effect's best candidate."""

    before: float
    rmse: dict[str, float]
    p_value: dict[str, float]
    taken: str
    equals: tuple[str, ...]
    runner_up: str


@dataclass(frozen=True, slots=True)
class Selection:
    """What was selected: the models from the plain one on, one effect more each."""

    path: tuple[Entry, ...]
    steps: tuple[Step, ...]

    @property
    def plain(self) -> Entry:
        """The model without any effect."""
        return self.path[0]

    @property
    def chosen(self) -> Entry:
        """The model with all effects that were taken."""
        return self.path[-1]

    def step_of(self, name: str) -> Step:
        """The step at which an effect was taken."""
        return next(step for step in self.steps if step.taken == name)


def select(problem: Problem, start: Optics, order: FloatArray, noise_grey: float) -> Selection:
    """Add the effect that lowers the cross-validated error most, until none is worth it.

    A mark on the gel, or a change with the session's time, that explains more than any effect
    ends the selection: effects would be bent to follow it.

    Parameters
    ----------
    order : (N,) float
        Place of each press in the session.
    noise_grey : float
        Standard deviation of the camera's noise.
    """
    contest = Contest.on(problem)
    plain = contest.start(start)
    path, steps, gone = [plain], [], set[str]()
    current = plain
    while len(current.taken) < MOST_EFFECTS:
        tried = [
            contest.add(current, candidate)
            for candidate in candidates(current.problem)
            if candidate.name not in gone and candidate.name not in current.names
        ]
        if not tried:
            break
        tried.sort(key=lambda entry: entry.rmse)
        tried[:FINALISTS] = [contest.further(entry) for entry in tried[:FINALISTS]]
        step, best = _judge(current, tried, noise_grey)
        followed = left_over(current, contest.folds, order, noise_grey, only=OUTSIDE)
        if followed and followed[0].gain_grey > current.rmse - best.rmse:
            step = replace(step, taken="")
        steps.append(step)
        if not step.taken:
            break
        current = contest.reformed(best)
        path.append(current)
        for name in current.names[:-1]:
            shorter = contest.without(current, name)
            if not _is_worth(shorter, current, len(tried), noise_grey):
                current = shorter
                gone.add(name)
                path = _rebuilt(contest, plain, current)
    return Selection(tuple(path), tuple(steps))


def _rebuilt(contest: Contest, plain: Entry, chosen: Entry) -> list[Entry]:
    """The models on the way to ``chosen``, after an effect has been taken out again."""
    path = [plain]
    for candidate in chosen.taken[:-1]:
        path.append(contest.add(path[-1], candidate))
    return [*path, chosen]


def _judge(current: Entry, tried: list[Entry], noise_grey: float) -> tuple[Step, Entry]:
    """Of the entries that the presses cannot tell from the best one, the simplest."""
    n_tried = len(tried)
    worth = [e for e in tried if _is_worth(current, e, n_tried, noise_grey)] or tried
    leader = min(worth, key=lambda entry: entry.rmse)
    equals = [entry for entry in worth if is_as_good(entry, leader, current)]
    best = min(equals, key=lambda entry: (entry.complexity(), entry.rmse))
    name = best.names[-1]
    by_name: dict[str, Entry] = {}
    for entry in sorted(tried, key=lambda entry: entry.rmse):
        by_name.setdefault(entry.names[-1], entry)
    others = [other for other in by_name if other != name]
    step = Step(
        before=current.rmse,
        rmse={other: entry.rmse for other, entry in by_name.items()},
        p_value={o: gain_p_value(current.squares, e.squares) for o, e in by_name.items()},
        taken=name if _is_worth(current, best, n_tried, noise_grey) else "",
        equals=tuple(dict.fromkeys(e.names[-1] for e in equals if e.names[-1] != name)),
        runner_up=others[0] if others else "",
    )
    return step, best


def _is_worth(shorter: Entry, longer: Entry, n_tried: int, noise_grey: float) -> bool:
    """Whether the longer model's gain is both sure and large enough."""
    if gain_p_value(shorter.squares, longer.squares) > FALSE_ALARM / n_tried:
        return False
    added = set(longer.names) - set(shorter.names)
    if added == {"saturation"}:
        return longer.rmse <= (1 - LEAST_GAIN_PILED) * shorter.rmse
    least_grey = noise_grey * (
        LEAST_STRETCH if added <= {"scale", "press_center"} else LEAST_EFFECT
    )
    stands_out = shorter.rmse**2 - longer.rmse**2 >= least_grey**2
    return stands_out and longer.rmse <= (1 - LEAST_GAIN) * shorter.rmse
