"""The page of the study of regrasping: success over regrasps, drops avoided, three episodes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.collection.pipeline import GraspPipeline, tactile_pad
from tacgen.dataset import overlays
from tacgen.envs.regrasp import Look, look_at
from tacgen.report.figures import GROUP_COLORS, new_figure
from tacgen.report.formatting import percent
from tacgen.report.page import (
    PageSection,
    figure_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)
from validation.regrasp.policies import POLICIES
from validation.regrasp.study import Episode, Played

NAMES = {
    "touch": "by touch",
    "random": "random regrasp",
    "blind": "blind: best in simulation",
    "oracle": "oracle",
}
OUTCOMES = {
    "held": "held",
    "translational_slip": "slipped out",
    "rotational_slip": "turned in the hand",
    "no_contact": "nothing between the pads",
    "unreachable": "out of reach",
    "crashed": "the simulation crashed",
}
LOOKS = {
    "grasp": "the image at the moment of grasp",
    "lift": "the images up to the start of the lift",
    "test lift": "the images up to a test lift",
}


def study_lines(result: Mapping[str, Any]) -> list[str]:
    """The result for a terminal, a line a policy."""
    head = f"{'':26s} success after 0 to {result['regrasps']} regrasps; of the oracle's gain"
    lines = [head]
    for name in POLICIES:
        scores = result["policies"][name]
        rates = ", ".join(f"{100 * one['success']['value']:.0f} %" for one in scores)
        lines.append(f"{NAMES[name]:>26s}  {rates}; {_rate(scores[-1]['share_of_gain'])}")
    return lines


def write_study_page(path: Path, result: Mapping[str, Any], played: Played) -> None:
    """Write the page of what ``study`` returns; the shown grasps are simulated again."""
    policies, allowed = result["policies"], result["regrasps"]
    touch, blind = policies["touch"], policies["blind"]
    before, after = _success(touch[0]), _success(touch[-1])
    rows = [
        (
            NAMES[name],
            _success(policies[name][-1]),
            _rate(policies[name][-1]["share_of_gain"]),
            _rate(policies[name][-1]["share_beyond_blind"]),
            policies[name][-1]["mean_regrasps"],
            sum(policies[name][-1]["drops"].values()),
            policies[name][-1]["not_executed"],
        )
        for name in POLICIES
    ]
    objects = [
        (name, *(percent(rates[one], 0) for one in ("first", *POLICIES)))
        for name, rates in result["by_object"].items()
    ]
    looks = LOOKS[result["looks"]]
    if result["looks"] == "test lift":
        looks += f" of at most {result['test_lift_mm']:.1f} mm, after which it is set down again"
    sections = [
        figure_section(
            "Success against regrasps",
            _curves(policies),
            "Share of episodes whose lift holds; bars are 95 % intervals (bootstrap over the "
            "episodes of each object). With 0 regrasps all policies lift the first grasp.",
        ),
        table_section(
            f"After at most {allowed} regrasps",
            (
                "policy",
                "success",
                "of the oracle's gain",
                "beyond blind",
                "regrasps",
                "failed lifts",
                "not executed",
            ),
            rows,
            f"Without a regrasp {_drops(touch[0])} of {_n(result)} lifts fail; by touch "
            f"{_drops(touch[-1])}, blind {_drops(blind[-1])}: touch avoids "
            f"{_drops(touch[0]) - _drops(touch[-1])}. Gain: success over that of the first grasps; "
            "beyond blind: over that of the grasp which holds in most simulated worlds.",
        ),
        table_section(
            "By object", ("object", "first grasp", *(NAMES[one] for one in POLICIES)), objects
        ),
        *_film(played, allowed),
        text_section(
            "What was played",
            f"{result['episodes']} episodes of each object, the same for all policies: its centre "
            "of mass and friction are drawn as the recipe says, and stay; the first grasp is drawn "
            "among the recipe's. Before each grasp the object rests as at first: nothing that "
            "an earlier grasp did to it stays.",
            f"A look is {looks}. By touch, the probability that the network gives this look weighs "
            f"{result['worlds']} worlds that the recipe draws, by how near it is to that of "
            "the same grasp in each of them; another grasp is rated by the weight of the worlds "
            "in which it holds. It is lifted where that costs less than to move to the best rated "
            f"grasp: a failed lift costs {result['costs']['drop']:g}, a regrasp "
            f"{result['costs']['regrasp']:g}. After the last regrasp it is lifted whatever the "
            "look says, so that each episode ends in a lift.",
            "Random regrasp looks and decides alike but moves anywhere else. Blind moves at once "
            "to the grasp that holds in most of these worlds, and looks at nothing. The oracle "
            "knows which grasps hold.",
            f"On these looks the network is right in {percent(result['network']['accuracy'])} of "
            f"all grasps that were executed, of which {percent(result['network']['holds'])} hold.",
        ),
    ]
    share = touch[-1]["share_of_gain"]
    write_page(
        path,
        f"Regrasping by touch: {result['recipe']}",
        sections,
        made_by="validation.regrasp",
        summary=f"Success {before} of the first grasps, {after} after at most {allowed} regrasps "
        f"by touch: {_rate(share)} of the oracle's gain.",
    )


def _n(result: Mapping[str, Any]) -> int:
    return int(result["episodes"]) * len(result["by_object"])


def _rate(rate: Mapping[str, Any]) -> str:
    if rate["value"] is None or rate["interval"] is None:
        return "–"
    ends = [100 * one for one in rate["interval"]]
    return f"{100 * rate['value']:.0f} % ({ends[0]:.0f} to {ends[1]:.0f})"


def _success(scores: Mapping[str, Any]) -> str:
    return _rate(scores["success"])


def _drops(scores: Mapping[str, Any]) -> int:
    return int(sum(scores["drops"].values()))


def _curves(policies: Mapping[str, Sequence[Mapping[str, Any]]]) -> Figure:
    figure, grid = new_figure(7.5, 3.8)
    axes = grid[0, 0]
    for k, name in enumerate(POLICIES):
        rates = [scores["success"] for scores in policies[name]]
        value = 100 * np.array([rate["value"] for rate in rates])
        ends = 100 * np.array([rate["interval"] for rate in rates])
        places = np.arange(len(rates)) + 0.05 * (k - 1.5)
        bars = np.abs(ends.T - value)
        axes.errorbar(
            places, value, yerr=bars, fmt="o-", ms=4, capsize=3, color=GROUP_COLORS[k],
            label=NAMES[name],
        )  # fmt: skip
    axes.set_xticks(range(len(policies["touch"])))
    axes.set(xlabel="regrasps allowed", ylabel="lifts that hold, %", ylim=(0, 103))
    axes.legend(frameon=False, fontsize=8, loc="lower right")
    return figure


def _film(played: Played, allowed: int) -> list[PageSection]:
    """Three episodes by touch: a regrasp that helped, the longest that did, and a failed lift."""
    chosen = shown_episodes(played.episodes["touch", allowed])
    if not chosen:
        return []
    sections, asked = [], played.asked
    with GraspPipeline(asked.recipe) as pipeline:
        pad = tactile_pad(asked.recipe)
        rest_px = overlays.to_pixels(pad.marker_rest_mm, pad.sensor.mm_per_px, pad.sensor.shape_px)
        for episode in chosen:
            grasps = played.simulated[episode.object].grasps
            items = []
            for number, step in enumerate(episode.steps, 1):
                planned = grasps[step.grasp]
                look = look_at(pipeline, planned, episode.seed, step.grasp, asked.spec, asked.pad)
                last = number == len(episode.steps)
                done = f"lifted: {OUTCOMES[episode.outcome]}" if last else "regrasp"
                config = planned.config
                place = (
                    f"y {config.y_mm:g} mm, z {config.z_mm:g} mm, yaw "
                    f"{np.degrees(config.yaw_rad):.0f}°"
                )
                wanted = f"asked {percent(max(step.threshold, 0.0), 0)}"
                wanted = "the last" if number > allowed else wanted
                caption = (
                    f"grasp {number}: {place}; success {percent(step.probability, 0)}, {wanted} → "
                    f"{done}"
                )
                items.append((caption, _drawn(look, rest_px, pad.sensor.mm_per_px)))
            moves = "1 regrasp" if number == 2 else f"{number - 1} regrasps"
            title = f"{episode.object}: {OUTCOMES[episode.outcome]} after {moves}"
            sections.append(pictures_section(title, items, _NOTE))
    return sections


_NOTE = (
    "The last image that the network sees of each grasp; arrows show how far markers have moved, "
    "drawn larger."
)


def shown_episodes(episodes: Sequence[Episode]) -> list[Episode]:
    """A short and a long one that regrasps and holds, and one that fails; of those that there are.

    First those whose first look was worst; of different objects where there are.
    """
    regrasped = [one for one in episodes if one.held and len(one.steps) > 1]
    ranked = [
        sorted(regrasped, key=lambda one: (len(one.steps), one.steps[0].probability)),
        sorted(regrasped, key=lambda one: (-len(one.steps), one.steps[0].probability)),
        sorted((one for one in episodes if not one.held), key=lambda one: -len(one.steps)),
    ]
    chosen: list[Episode] = []
    for listed in ranked:
        others = [e for e in listed if e.object not in {c.object for c in chosen}] or listed
        chosen += [e for e in others if e not in chosen][:1]
    return chosen


def _drawn(look: Look, rest_px: NDArray[np.floating], mm_per_px: float) -> NDArray[np.uint8]:
    """The last image with the markers' motion (M, 2) from their places at rest."""
    image = np.ascontiguousarray(look.images[-1])
    if look.pad.markers_mm is None:
        return image
    moved_mm = look.pad.markers_mm[look.frames[-1]]
    room_mm = overlays.spacing_mm(rest_px * mm_per_px)
    gain = overlays.gain_of(float(np.linalg.norm(moved_mm, axis=1).max()), room_mm)
    for start, step in zip(rest_px, gain * moved_mm / mm_per_px, strict=True):
        begin, end = (np.round(one).astype(int).tolist() for one in (start, start + step))
        head = overlays.HEAD_SHARE
        cv2.arrowedLine(image, begin, end, (255, 255, 255), 1, cv2.LINE_AA, tipLength=head)
    return image
