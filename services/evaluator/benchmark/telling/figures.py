"""Figures of the benchmark: success, first solutions, boxes by family, cost of optimising planners."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from services.evaluator.benchmark.runs.arms import Arm, Group
from services.evaluator.benchmark.summary.convergence import best_known
from services.evaluator.benchmark.summary.paired import Floats, PairedRuns
from services.evaluator.benchmark.summary.results import FamilyResult, Results
from services.evaluator.benchmark.telling.count_figure import count_figure
from services.evaluator.benchmark.telling.curves import STYLE, Look, looks, panel_of, share_until

# What a column is shown as: its name, a factor, words, and the least that a logarithmic axis shows.
Axis = tuple[str, float, str, float]
_ITERATIONS: Axis = ("iterations", 1.0, "iterations", 1.0)
_TOTAL: Axis = ("total_s", 1e3, "request and search (ms)", 1e-3)
SUCCESS_AXES = (_ITERATIONS, ("edge_checks", 1.0, "edge checks", 1.0), _TOTAL)
TIME_AXES = (("solve_s", 1e3, "search alone (ms)", 1e-3), _TOTAL)
BOX_AXES = (_ITERATIONS, _TOTAL)
COST_AXES = (("cost_iterations", 1.0, "iterations"), ("cost_s", 1e3, "time of the search (ms)"))
_POINTS = 200
TALLEST = 1.8


def all_figures(results: Results) -> Iterator[tuple[str, Figure]]:
    """Every figure with its name."""
    solvable = [found for found in results.families.values() if found.solvable]
    for found in solvable:
        arms = _present(results.arms, found.runs, stop_at_first=True)
        plain = [arm for arm in arms if arm.group in (Group.UNIFORM, Group.LEARNED)]
        if plain:
            yield f"success-{found.family}", success_figure(found, plain)
        if arms:
            yield f"first-solution-{found.family}", first_solution_figure(found, arms)
        optimising = _present(results.arms, found.runs, stop_at_first=False)
        if optimising:
            yield f"cost-{found.family}", cost_figure(found, optimising)
        counts = [arm for arm in results.arms if arm.group is Group.COUNTS]
        if counts:
            yield f"samples-{found.family}", count_figure(found.runs, counts)
    everywhere = [arm for arm in results.arms if arm.stop_at_first and arm.group is not Group.COUNTS]
    if everywhere:
        yield "boxes", box_figure(list(results.families.values()), everywhere)


def success_figure(found: FamilyResult, arms: Sequence[Arm]) -> Figure:
    """Share solved against iterations, edge checks and whole time, a row a planner."""
    panels = list(dict.fromkeys(panel_of(arm) for arm in arms))
    look = looks(arms)
    with rc_context(STYLE):
        figure = _figure(12.5, 0.6 + 2.7 * len(panels))
        grid = figure.subplots(len(panels), len(SUCCESS_AXES), squeeze=False, sharex="col", sharey=True)
        for row, panel in zip(grid, panels, strict=True):
            mine = [arm for arm in arms if panel_of(arm) == panel]
            for axes, shown in zip(row, SUCCESS_AXES, strict=True):
                for arm in mine:
                    _draw_share(axes, found.runs, arm, shown, look[arm.name])
                axes.set_xscale("log")
                axes.set_xlabel(shown[2])
            row[0].set_ylabel(f"{panel}\nshare solved")
            row[-1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8)
        figure.suptitle(f"Share of {found.family} problems solved")
    return figure


def first_solution_figure(found: FamilyResult, arms: Sequence[Arm]) -> Figure:
    """Times to the first solution: every run a point, boxes over those that succeeded."""
    with rc_context(STYLE):
        figure = _figure(11.5, 1.2 + 0.34 * len(arms))
        grid = figure.subplots(1, len(TIME_AXES), sharey=True)
        for axes, shown in zip(grid, TIME_AXES, strict=True):
            _draw_boxes(axes, found.runs, arms, shown)
        figure.suptitle(f"Time to the first solution, {found.family}; at the right the share without one")
    return figure


def box_figure(families: Sequence[FamilyResult], arms: Sequence[Arm]) -> Figure:
    """Iterations and whole time of every arm, a column a family."""
    with rc_context(STYLE):
        figure = _figure(3.4 + 4.2 * len(families), 1.2 + 0.34 * len(arms) * len(BOX_AXES))
        grid = figure.subplots(len(BOX_AXES), len(families), squeeze=False, sharey=True)
        for row, shown in zip(grid, BOX_AXES, strict=True):
            for axes, found in zip(row, families, strict=True):
                _draw_boxes(axes, found.runs, arms, shown, everything=not found.solvable)
                axes.set_title(found.family if found.solvable else f"{found.family} (until given up)")
        figure.suptitle(
            "Boxes: quartiles and median; whiskers: 5 % and 95 %; at the right the share unsolved"
        )
    return figure


def cost_figure(found: FamilyResult, arms: Sequence[Arm]) -> Figure:
    """Length of the best path over the best known, against iterations and time: median and quartiles."""
    best, look = best_known(found.runs), looks(arms)
    with rc_context(STYLE):
        figure = _figure(11.5, 4.6)
        grid = figure.subplots(1, len(COST_AXES), sharey=True)
        for axes, (column, scale, label) in zip(grid, COST_AXES, strict=True):
            for arm in arms:
                _draw_cost(axes, found.runs, arm, best, column, scale, look[arm.name])
            axes.set_xscale("log")
            axes.set_xlabel(label)
        grid[0].set_ylabel("length over the best known")
        grid[0].set_ylim(0.98, TALLEST)
        grid[-1].legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8)
        figure.suptitle(f"Optimising planners, {found.family}: median over all runs, quartiles shaded")
    return figure


def cost_at(series: Sequence[tuple[Floats, Floats]], at: Floats) -> Floats:
    """(n, m) the last length of each of n runs at m places; infinite before the first solution.

    Args:
        series: of each run the places of its improvements, ascending, and the lengths from there on.
        at: (m,) places.
    """
    rows = []
    for places, lengths in series:
        held = np.concatenate([[np.inf], lengths])
        rows.append(held[np.searchsorted(places, at, side="right")])
    return np.array(rows)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _present(arms: Sequence[Arm], runs: PairedRuns, *, stop_at_first: bool) -> list[Arm]:
    wanted = (arm for arm in arms if arm.name in runs.arms and arm.group is not Group.COUNTS)
    return [arm for arm in wanted if arm.stop_at_first is stop_at_first]


def _draw_share(axes: Any, runs: PairedRuns, arm: Arm, shown: Axis, look: Look) -> None:
    column, scale, _, least = shown
    taken, shares = share_until(scale * runs.values(arm.name, column).ravel(), runs.solved(arm.name).ravel())
    axes.plot(
        np.maximum(taken, least), shares, look.line, color=look.colour, drawstyle="steps-post",
        linewidth=1.4, label=arm.name,
    )  # fmt: skip
    axes.set_ylim(-0.02, 1.02)


def _draw_boxes(
    axes: Any, runs: PairedRuns, arms: Sequence[Arm], shown: Axis, *, everything: bool = False
) -> None:
    look, (column, scale, label, least) = looks(arms), shown
    for height, arm in enumerate(arms):
        solved = runs.solved(arm.name).ravel()
        values = scale * runs.values(arm.name, column).ravel()
        drawn = np.maximum(values if everything else values[solved], least)
        colour = look[arm.name].colour
        if len(drawn):
            jitter = np.random.default_rng(height).uniform(-0.28, 0.28, len(drawn))
            axes.scatter(drawn, height + jitter, s=6, color=colour, alpha=0.35, linewidths=0)
            axes.boxplot(
                drawn, positions=[height], orientation="horizontal", widths=0.55, whis=(5, 95),
                showfliers=False, medianprops={"color": colour, "linewidth": 2.0},
                boxprops={"color": colour}, whiskerprops={"color": colour}, capprops={"color": colour},
            )  # fmt: skip
        if not solved.all():
            text = f"{100.0 * (1.0 - solved.mean()):.3g} %"
            axes.text(1.01, height, text, transform=axes.get_yaxis_transform(), va="center", fontsize=7)
    axes.set_xscale("log")
    axes.set_xlabel(label)
    axes.set_yticks(range(len(arms)), [arm.name for arm in arms])
    axes.set_ylim(len(arms) - 0.5, -0.5)


def _draw_cost(
    axes: Any, runs: PairedRuns, arm: Arm, best: Floats, column: str, scale: float, look: Look
) -> None:
    mine, columns = runs.runs(arm.name), len(runs.numbers)
    series = [
        (scale * np.array(getattr(run, column), dtype=float), np.array(run.cost_length_rad) / one)
        for run, one in zip(mine, np.repeat(best, columns), strict=True)
        if np.isfinite(one)
    ]
    places = [value for steps, _ in series for value in steps if value > 0.0]
    if not places:
        return
    ends = {"cost_iterations": "iterations", "cost_s": "solve_s"}
    last = scale * float(np.median(runs.values(arm.name, ends[column])))
    at = np.geomspace(min(places), max(last, *places), _POINTS)
    low, middle, high = np.quantile(cost_at(series, at), [0.25, 0.5, 0.75], axis=0, method="higher")
    axes.plot(at, _shown(middle), look.line, color=look.colour, linewidth=1.6, label=arm.name)
    held = np.isfinite(middle)
    axes.fill_between(
        at[held], low[held], np.minimum(high, TALLEST)[held], color=look.colour, alpha=0.08, linewidth=0
    )


def _shown(values: Floats) -> Floats:
    # What is not there yet is left out.
    return np.where(np.isfinite(values), values, np.nan)
