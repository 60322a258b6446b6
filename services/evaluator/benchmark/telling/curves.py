"""How arms are told apart in figures: a colour for each sampler, a line for each share, a panel a planner."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from services.evaluator.benchmark.runs.arms import DEFAULT_SHARE, NAMES, Arm
from services.evaluator.benchmark.summary.paired import Flags, Floats
from services.planner.drawing import palette
from services.planner.settings import (
    BIT_STAR,
    INFORMED_RRT_STAR,
    OPTIMISING_PLANNERS,
    RRT_CONNECT,
    SAMPLED_CONNECT,
)

# Told apart by most eyes, and in print by their lightness (after Okabe and Ito).
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_UNIFORM_LINES = {SAMPLED_CONNECT: "--", INFORMED_RRT_STAR: "--", BIT_STAR: ":"}
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelcolor": palette.INK,
    "axes.edgecolor": "#b8bcc4",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#e6e8ec",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "text.color": palette.INK,
    "xtick.color": palette.MUTED,
    "ytick.color": palette.MUTED,
}


@dataclass(frozen=True, slots=True)
class Look:
    """Of an arm in every figure."""

    colour: str
    line: str


def looks(arms: Sequence[Arm]) -> Mapping[str, Look]:
    """By name of the arm; uniform ones are grey."""
    samplers = list(dict.fromkeys(arm.sampler for arm in arms if arm.sampler is not None))
    colours = {name: _COLOURS[index % len(_COLOURS)] for index, name in enumerate(samplers)}
    ranges_rad = {arm.name: arm.range_rad for arm in arms}
    return {
        arm.name: Look(
            palette.INK if arm.sampler is None else colours[arm.sampler],
            _line(arm, ranges_rad.get(arm.base, arm.range_rad)),
        )
        for arm in arms
    }


def panel_of(arm: Arm) -> str:
    """The panel of an arm in a figure; both RRT-Connects share one, the optimising planners another."""
    if arm.planner in OPTIMISING_PLANNERS:
        return " / ".join(NAMES[planner] for planner in OPTIMISING_PLANNERS)
    return NAMES[RRT_CONNECT] if arm.planner == SAMPLED_CONNECT else NAMES.get(arm.planner, arm.planner)


def share_until(values: Floats, solved: Flags) -> tuple[Floats, Floats]:
    """The share of all runs that succeeded with at most so much: steps for ``drawstyle="steps-post"``.

    Args:
        values: (n,) what each run took.
        solved: (n,) whether it succeeded.

    Returns:
        (m,) what was taken, ascending, and (m,) shares; m is the number of successes, and one more.
    """
    taken = np.sort(values[solved])
    shares = np.arange(len(taken) + 1) / len(values)
    first = taken[:1] if len(taken) else np.ones(1)
    return np.concatenate([first, taken]), shares


def _line(arm: Arm, usual_rad: float) -> str:
    if arm.sampler is not None:
        return "-" if arm.learned_share == DEFAULT_SHARE else "--"
    if arm.range_rad != usual_rad:
        return ":" if arm.range_rad < usual_rad else "-."
    return _UNIFORM_LINES.get(arm.planner, "-")
