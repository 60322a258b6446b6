"""Figures of the benchmark, and a page for each of the first problems."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cspace.problem import Problem
from cspace.worlds import picture_of, workshop_of
from services.evaluator.benchmark.arms import DEFAULT_SHARE, NAMES, Arm, Group, Setting
from services.evaluator.benchmark.measure import known_problem
from services.evaluator.benchmark.report import WITHIN_COUNTS
from services.evaluator.benchmark.results import FamilyResult, Results, best_known
from services.evaluator.benchmark.sources import SourceSpec, ask, opened
from services.evaluator.benchmark.summary import Flags, Floats, PairedRuns
from services.evaluator.evaluation.units import planner_seed
from services.evaluator.statistics import clopper_pearson
from services.planner.drawing import palette
from services.planner.drawing.configuration_panel import draw_configurations
from services.planner.drawing.workspace_panel import draw_workspace
from services.planner.search.ompl_planner import PlanResult, solve
from services.planner.settings import (
    BIT_STAR,
    INFORMED_RRT_STAR,
    OPTIMISING_PLANNERS,
    RRT,
    RRT_CONNECT,
    SAMPLED_CONNECT,
)
from services.planner.sources.samples import SampleBatch

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


def count_figure(runs: PairedRuns, arms: Sequence[Arm]) -> Figure:
    """Share solved within some numbers of iterations, a panel each, with exact 95 % limits.

    Args:
        runs: of one family.
        arms: that differ in how many samples they ask for; one line a sampler.
    """
    samplers = list(dict.fromkeys(arm.sampler for arm in arms))
    look = looks(arms)
    with rc_context(STYLE):
        figure = Figure(figsize=(11.5, 3.9), dpi=110, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(1, len(WITHIN_COUNTS), sharey=True)
        for axes, within in zip(grid, WITHIN_COUNTS, strict=True):
            for sampler in samplers:
                mine = sorted((arm for arm in arms if arm.sampler == sampler), key=lambda arm: arm.samples)
                shares = [_share(runs, arm, within) for arm in mine]
                middle, low, high = np.transpose(shares)
                axes.errorbar(
                    [arm.samples for arm in mine], middle, [middle - low, high - middle],
                    color=look[mine[0].name].colour, marker="o", markersize=4, capsize=3, label=sampler,
                )  # fmt: skip
            axes.set_xscale("log")
            axes.set_xlabel("samples asked for")
            axes.set_title(f"within {within} iterations")
            axes.set_ylim(-0.02, 1.02)
        grid[0].set_ylabel("share solved")
        grid[-1].legend(loc="lower right", frameon=False, fontsize=8)
        figure.suptitle(f"RRT on {runs.family} problems against the number of learned samples")
    return figure


def _share(runs: PairedRuns, arm: Arm, within: int) -> tuple[float, float, float]:
    solved = runs.solved(arm.name) & (runs.values(arm.name, "iterations") <= within)
    found = clopper_pearson(int(solved.sum()), solved.size)
    return found.estimate, found.low, found.high


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


# More would not fit on a page.
SAMPLERS = 3


def page_arms(arms: Sequence[Arm]) -> list[Arm]:
    """RRT with uniform samples, and with those of up to three samplers at the usual share."""
    plain = [arm for arm in arms if arm.planner == RRT and arm.name == arm.base]
    learned = [
        arm
        for arm in arms
        if arm.planner == RRT and arm.group is Group.LEARNED and arm.learned_share == DEFAULT_SHARE
    ]
    return plain[:1] + learned[:SAMPLERS]


def pages(
    problems: Mapping[str, int], arms: Sequence[Arm], setting: Setting, specs: Sequence[SourceSpec]
) -> Iterator[tuple[str, Figure]]:
    """The first problems of every family, each with its name.

    Args:
        problems: how many pages a family.
        arms: of which :func:`page_arms` are shown.
        setting: of the runs.
        specs: the samplers.

    Raises:
        SamplerError: a sampler does not answer.
    """
    shown, by_name = page_arms(arms), {spec.name: spec for spec in specs}
    with opened(specs, setting.world) as sources:
        for family, count in problems.items():
            for index in range(count):
                problem = known_problem(setting.world, family, setting.split, setting.seed, index)
                seed = planner_seed(setting.seed, index, 0)
                panels = []
                for arm in shown:
                    batch = None
                    if arm.sampler is not None:
                        batch = ask(sources[arm.sampler], by_name[arm.sampler], problem, arm.query(seed))
                    panels.append((arm, _solved(problem, arm, setting, index, batch), batch))
                yield f"page-{family}-{index:02d}", page(problem, panels, f"{family}, problem {index}")


def page(
    problem: Problem, panels: Sequence[tuple[Arm, PlanResult, SampleBatch | None]], title: str
) -> Figure:
    """One problem.

    Args:
        problem: what was solved.
        panels: arms with result and samples; the last one's path is shown in the workspace.
        title: of the page.
    """
    figure = Figure(figsize=(4.3 * (2 + len(panels)), 5.2), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2 + len(panels))
    _draw_picture(axes[0], problem)
    arm, result, _ = panels[-1]
    draw_workspace(axes[1], problem, result.path)
    axes[1].set_title(f"workspace, path of\n{arm.name}" if result.solved else "workspace\n", fontsize=10)
    for one, (arm, result, batch) in zip(axes[2:], panels, strict=True):
        draw_configurations(one, problem, result, None if batch is None else batch.samples, (0, 1))
        one.set_title(f"{arm.name}\n{_outcome(result)}", fontsize=10)
    gap = "none" if problem.bottleneck_rad == 0.0 else f"{problem.bottleneck_rad:.3f} rad"
    figure.suptitle(f"{title}, bottleneck {gap}")
    figure.legend(handles=_handles(), loc="outside lower center", ncols=6, frameon=False)
    return figure


def _solved(
    problem: Problem, arm: Arm, setting: Setting, index: int, batch: SampleBatch | None
) -> PlanResult:
    samples = None if batch is None else batch.samples
    settings = setting.planner(arm, index, 0)
    return solve(problem, settings, samples, 1.0 - arm.learned_share, keep_tree=True)


def _outcome(result: PlanResult) -> str:
    if not result.solved:
        return f"{result.reason} ({result.iterations})"
    return f"{result.iterations} iterations, {result.edge_checks} edges, {result.length_rad:.2f} rad"


def _draw_picture(axes: Any, problem: Problem) -> None:
    workshop_of(problem.scenario.world).draw_picture(axes, np.asarray(picture_of(problem.scenario)))
    axes.set_title("the picture that the sampler sees\n", fontsize=10)


def _handles() -> list[Line2D]:
    marks = (
        ("start", palette.START, "o"),
        ("goal", palette.GOAL, "D"),
        ("learned samples", palette.LEARNED, "."),
    )
    lines = (("search tree", palette.TREE, 1.0), ("path", palette.PATH, 2.4))
    return [
        *(
            Line2D([], [], linestyle="", marker=mark, color=colour, label=name)
            for name, colour, mark in marks
        ),
        *(Line2D([], [], color=colour, linewidth=width, label=name) for name, colour, width in lines),
    ]
