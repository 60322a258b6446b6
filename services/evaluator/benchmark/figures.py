"""Figures of the benchmark, and a page for each of the first problems."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cspace.simulator import Problem
from cspace.worlds import picture_of, simulator_of
from services.evaluator.benchmark.arms import DEFAULT_SHARE, NAMES, Arm, Group, PlanArm, Setting
from services.evaluator.benchmark.samples import known_problem
from services.evaluator.benchmark.sources import SourceSpec, ask, opened
from services.evaluator.benchmark.summary import (
    WITHIN_COUNTS,
    Flags,
    Floats,
    Paired,
    best_known,
    confidence_curve,
    plan_groups,
)
from services.evaluator.statistics import clopper_pearson
from services.planner.ompl_planner import solve
from services.planner.plotting import (
    GOAL,
    INK,
    LEARNED,
    MUTED,
    PATH,
    START,
    TREE,
    plot_configurations,
    plot_workspace,
)
from services.planner.result import PlanResult
from services.planner.samples import SampleBatch
from services.planner.settings import (
    BIT_STAR,
    INFORMED_RRT_STAR,
    OPTIMISING_PLANNERS,
    RRT,
    RRT_CONNECT,
    SAMPLED_CONNECT,
)

# Told apart by most eyes, and in print by their lightness (after Okabe and Ito).
_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_UNIFORM_LINES = {SAMPLED_CONNECT: "--", INFORMED_RRT_STAR: "--", BIT_STAR: ":"}
_MARKS = "osD^v<>P"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b8bcc4",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#e6e8ec",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
}
_BESIDE: dict[str, Any] = {
    "loc": "upper left", "bbox_to_anchor": (1.01, 1.0), "frameon": False, "fontsize": 8,
}  # fmt: skip
_POINTS = 200
TALLEST = 1.8


class Axis(NamedTuple):
    """How a column is shown; ``least`` is the smallest value on its logarithmic axis."""

    column: str
    scale: float
    label: str
    least: float


_ITERATIONS = Axis("iterations", 1.0, "iterations", 1.0)
_CHECKS = Axis("edge_checks", 1.0, "edge checks", 1.0)
_SOLVE = Axis("solve_s", 1e3, "search alone (ms)", 1e-3)
_TOTAL = Axis("total_s", 1e3, "request and search (ms)", 1e-3)
_COSTS = (
    ("cost_iterations", "iterations", 1.0, "iterations"),
    ("cost_s", "solve_s", 1e3, "time of the search (ms)"),
)


def looks(arms: Sequence[Arm]) -> Mapping[str, tuple[str, str]]:
    """Colour and line of each arm in every figure; uniform ones are grey."""
    samplers = list(dict.fromkeys(arm.sampler for arm in arms if arm.sampler is not None))
    ranges_rad = {arm.name: arm.range_rad for arm in arms}

    def line(arm: Arm) -> str:
        if arm.sampler is not None:
            return "-" if arm.learned_share == DEFAULT_SHARE else "--"
        usual_rad = ranges_rad.get(arm.base, arm.range_rad)
        if arm.range_rad != usual_rad:
            return ":" if arm.range_rad < usual_rad else "-."
        return _UNIFORM_LINES.get(arm.planner, "-")

    def colour(arm: Arm) -> str:
        return INK if arm.sampler is None else _COLOURS[samplers.index(arm.sampler) % len(_COLOURS)]

    return {arm.name: (colour(arm), line(arm)) for arm in arms}


def panel_of(arm: Arm) -> str:
    """The panel of an arm in a figure; both RRT-Connects share one, the optimising planners another."""
    if arm.planner in OPTIMISING_PLANNERS:
        return " / ".join(NAMES[planner] for planner in OPTIMISING_PLANNERS)
    return NAMES[RRT_CONNECT] if arm.planner == SAMPLED_CONNECT else NAMES.get(arm.planner, arm.planner)


def share_until(values: Floats, solved: Flags) -> tuple[Floats, Floats]:
    """The empirical distribution of the (n,) values that runs took, as steps for ``drawstyle="steps-post"``.

    Returns:
        (m + 1,) values, ascending, and (m + 1,) shares of all n runs, for m successes.
    """
    taken = np.sort(values[solved])
    shares = np.arange(len(taken) + 1) / len(values)
    first = taken[:1] if len(taken) else np.ones(1)
    return np.concatenate([first, taken]), shares


def sample_figures(
    runs: pd.DataFrame, families: Sequence[str], arms: Sequence[Arm], setting: Setting
) -> Iterator[tuple[str, Figure]]:
    """Every figure of the protocols ``families`` and ``paper`` with its name."""
    paired = {family: Paired(runs[runs["family"] == family]) for family in families}
    plain = [arm for arm in arms if arm.group is not Group.COUNTS]
    for family in (one for one in families if one in setting.families.solvable):
        found = paired[family]
        first = [arm for arm in plain if arm.stop_at_first and arm.name in found.arms]
        basic = [arm for arm in first if arm.group in (Group.UNIFORM, Group.LEARNED)]
        if basic:
            yield f"success-{family}", success_figure(family, found, basic)
        if first:
            title = f"Time to the first solution, {family}; at the right the share without one"
            yield f"first-solution-{family}", box_figure(title, {family: found}, (_SOLVE, _TOTAL), first)
        optimising = [arm for arm in plain if not arm.stop_at_first and arm.name in found.arms]
        if optimising:
            yield f"cost-{family}", cost_figure(family, found, optimising)
        counts = [arm for arm in arms if arm.group is Group.COUNTS and arm.name in found.arms]
        if counts:
            yield f"samples-{family}", count_figure(family, found, counts)
    everywhere = [arm for arm in plain if arm.stop_at_first]
    if everywhere:
        title = "Boxes: quartiles and median; whiskers: 5 % and 95 %; at the right the share unsolved"
        unsolvable = [family for family in families if family not in setting.families.solvable]
        yield "boxes", box_figure(title, paired, (_ITERATIONS, _TOTAL), everywhere, unsolvable)


def _figure(width: float, height: float, dpi: int = 110) -> Figure:
    return Figure(figsize=(width, height), dpi=dpi, layout="constrained")


def success_figure(family: str, paired: Paired, arms: Sequence[Arm]) -> Figure:
    """Share solved against iterations, edge checks and whole time, a row for each planner."""
    panels, look = list(dict.fromkeys(panel_of(arm) for arm in arms)), looks(arms)
    with rc_context(STYLE):
        figure = _figure(12.5, 0.6 + 2.7 * len(panels))
        grid = figure.subplots(len(panels), 3, squeeze=False, sharex="col", sharey=True)
        for row, panel in zip(grid, panels, strict=True):
            for axes, shown in zip(row, (_ITERATIONS, _CHECKS, _TOTAL), strict=True):
                for arm in (one for one in arms if panel_of(one) == panel):
                    values = shown.scale * paired.values(arm.name, shown.column).ravel()
                    taken, shares = share_until(values, paired.solved(arm.name).ravel())
                    how = dict(zip(("color", "linestyle"), look[arm.name], strict=True))
                    axes.step(np.maximum(taken, shown.least), shares, where="post", label=arm.name, **how)
                axes.set(xscale="log", xlabel=shown.label, ylim=(-0.02, 1.02))
            row[0].set_ylabel(f"{panel}\nshare solved")
            row[-1].legend(**_BESIDE)
        figure.suptitle(f"Share of {family} problems solved")
    return figure


def box_figure(
    title: str,
    families: Mapping[str, Paired],
    shown: Sequence[Axis],
    arms: Sequence[Arm],
    unsolvable: Sequence[str] = (),
) -> Figure:
    """Every successful run a point, with boxes; a row for each axis, a column for each family.

    Of families without paths all runs are shown.
    """
    look = looks(arms)
    with rc_context(STYLE):
        figure = _figure(3.4 + 4.2 * len(families), 1.2 + 0.34 * len(arms) * len(shown))
        grid = figure.subplots(len(shown), len(families), squeeze=False, sharey=True)
        for row, axis in zip(grid, shown, strict=True):
            for axes, (family, paired) in zip(row, families.items(), strict=True):
                for height, arm in enumerate(arms):
                    _draw_boxes(axes, paired, arm, axis, height, look[arm.name][0], family in unsolvable)
                axes.set_yticks(range(len(arms)), [arm.name for arm in arms])
                axes.set(xscale="log", xlabel=axis.label, ylim=(len(arms) - 0.5, -0.5))
                axes.set_title(f"{family} (until given up)" if family in unsolvable else family)
        figure.suptitle(title)
    return figure


def _draw_boxes(
    axes: Any, paired: Paired, arm: Arm, axis: Axis, height: int, colour: str, everything: bool
) -> None:
    solved = paired.solved(arm.name).ravel()
    values = axis.scale * paired.values(arm.name, axis.column).ravel()
    shown = np.maximum(values if everything else values[solved], axis.least)
    if len(shown):
        jitter = np.random.default_rng(height).uniform(-0.28, 0.28, len(shown))
        axes.scatter(shown, height + jitter, s=6, color=colour, alpha=0.35, linewidths=0)
        props: dict[str, Any] = {f"{one}props": {"color": colour} for one in ("box", "whisker", "cap")}
        props["medianprops"] = {"color": colour, "linewidth": 2.0}
        axes.boxplot(
            shown, positions=[height], orientation="horizontal", widths=0.55, whis=(5, 95), showfliers=False,
            **props,
        )  # fmt: skip
    if not solved.all():
        text = f"{100.0 * (1.0 - solved.mean()):.3g} %"
        axes.text(1.01, height, text, transform=axes.get_yaxis_transform(), va="center", fontsize=7)


def count_figure(family: str, paired: Paired, arms: Sequence[Arm]) -> Figure:
    """Share solved within some iterations against the samples requested, with exact 95 % limits."""
    look = looks(arms)
    with rc_context(STYLE):
        figure = _figure(11.5, 3.9)
        grid = figure.subplots(1, len(WITHIN_COUNTS), sharey=True)
        for axes, within in zip(grid, WITHIN_COUNTS, strict=True):
            for sampler in dict.fromkeys(arm.sampler for arm in arms):
                mine = sorted((arm for arm in arms if arm.sampler == sampler), key=lambda arm: arm.samples)
                flags = [
                    paired.solved(arm.name) & (paired.values(arm.name, "iterations") <= within)
                    for arm in mine
                ]
                shares = [clopper_pearson(int(solved.sum()), solved.size) for solved in flags]
                middle, low, high = np.transpose([(one.estimate, one.low, one.high) for one in shares])
                axes.errorbar(
                    [arm.samples for arm in mine], middle, [middle - low, high - middle],
                    color=look[mine[0].name][0], marker="o", markersize=4, capsize=3, label=sampler,
                )  # fmt: skip
            axes.set(xscale="log", xlabel="samples requested", ylim=(-0.02, 1.02))
            axes.set_title(f"within {within} iterations")
        grid[0].set_ylabel("share solved")
        grid[-1].legend(loc="lower right", frameon=False, fontsize=8)
        figure.suptitle(f"RRT on {family} problems against the number of learned samples")
    return figure


def cost_figure(family: str, paired: Paired, arms: Sequence[Arm]) -> Figure:
    """Length of the best path over the best known, against iterations and time: median and quartiles."""
    best, look = np.repeat(best_known(paired), paired.repeats), looks(arms)
    with rc_context(STYLE):
        figure = _figure(11.5, 4.6)
        grid = figure.subplots(1, len(_COSTS), sharey=True)
        for axes, (column, end, scale, label) in zip(grid, _COSTS, strict=True):
            for arm in arms:
                own = paired.of(arm.name)
                series = [
                    (scale * np.asarray(at, dtype=float), np.asarray(lengths, dtype=float) / one)
                    for at, lengths, one in zip(own[column], own["cost_length_rad"], best, strict=True)
                    if np.isfinite(one)
                ]
                last = scale * float(own[end].median())
                _draw_cost(axes, arm.name, series, last, look[arm.name])
            axes.set(xscale="log", xlabel=label)
        grid[0].set(ylabel="length over the best known", ylim=(0.98, TALLEST))
        grid[-1].legend(**_BESIDE)
        figure.suptitle(f"Optimising planners, {family}: median over all runs, quartiles shaded")
    return figure


def _draw_cost(
    axes: Any, name: str, series: Sequence[tuple[Floats, Floats]], last: float, look: tuple[str, str]
) -> None:
    places = [value for steps, _ in series for value in steps if value > 0.0]
    if not places:
        return
    at = np.geomspace(min(places), max(last, *places), _POINTS)
    low, middle, high = np.quantile(cost_at(series, at), [0.25, 0.5, 0.75], axis=0, method="higher")
    colour, line = look
    held = np.isfinite(middle)
    axes.plot(at, np.where(held, middle, np.nan), line, color=colour, linewidth=1.6, label=name)
    axes.fill_between(
        at[held], low[held], np.minimum(high, TALLEST)[held], color=colour, alpha=0.08, linewidth=0
    )


def cost_at(series: Sequence[tuple[Floats, Floats]], at: Floats) -> Floats:
    """(n, m) the last length of each of n runs at m places; infinite before the first solution.

    A run's series are the places of its improvements, ascending, and the lengths from there on.
    """
    held = [(places, np.concatenate([[np.inf], lengths])) for places, lengths in series]
    return np.array([lengths[np.searchsorted(places, at, side="right")] for places, lengths in held])


def safety_figure(
    runs: pd.DataFrame, pictures: Sequence[int], arms: Sequence[PlanArm], setting: Setting
) -> Figure:
    """Share of colliding paths against answered problems: a curve for each model, a mark for every other arm.

    One panel for each source of problems and number of pictures.
    """
    sources = list(dict.fromkeys(runs["source"]))
    groups = plan_groups(runs[~runs["checked"]], pictures, setting)
    with rc_context(STYLE):
        figure = _figure(4.2 * len(pictures) + 0.6, 3.9 * len(sources) + 0.7)
        grid = figure.subplots(len(sources), len(pictures), squeeze=False, sharex=True, sharey=True)
        for row, source in zip(grid, sources, strict=True):
            for axes, count in zip(row, pictures, strict=True):
                group = groups.get(f"{source}, {count}")
                if group is None:
                    axes.set_visible(False)
                    continue
                paired = Paired(group)
                _draw_safety(axes, paired, [arm for arm in arms if arm.name in paired.arms])
                shown = "one picture" if count == 1 else f"{count} pictures"
                number = f"{paired.problems} problem{'s' * (paired.problems > 1)}"
                axes.set_title(f"{source}, {shown}\n{number}", fontsize=10)
            row[0].set_ylabel("share of the paths that collide")
        for axes in grid[-1]:
            axes.set_xlabel("share of the problems that are answered")
        handles, labels = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _draw_safety(axes: Any, paired: Paired, arms: Sequence[PlanArm]) -> None:
    for number, arm in enumerate(sorted(arms, key=lambda arm: arm.sampler is None)):
        own = paired.of(arm.name)
        if arm.sampler is not None:
            curve, label = confidence_curve(own), f"{arm.name}, by min_confidence"
            axes.plot(curve["answered"], curve["collide"], color=f"C{number}", label=label, linewidth=1.8)
            continue
        collide = (own.loc[own["solved"], "clearance_m"] <= 0.0).mean()
        mark = _MARKS[number % len(_MARKS)]
        axes.plot(
            [own["solved"].mean()], [collide], mark, color=f"C{number}", label=arm.name, markersize=7,
            clip_on=False, zorder=3,
        )  # fmt: skip
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))


# More would not fit on a page.
SAMPLERS = 3


def page_arms(arms: Sequence[Arm]) -> list[Arm]:
    """RRT with uniform samples, and with those of up to three samplers at the usual share."""
    own = [arm for arm in arms if arm.planner == RRT]
    learned = [arm for arm in own if arm.group is Group.LEARNED and arm.learned_share == DEFAULT_SHARE]
    return [arm for arm in own if arm.name == arm.base][:1] + learned[:SAMPLERS]


def pages(
    problems: Mapping[str, int], arms: Sequence[Arm], setting: Setting, specs: Sequence[SourceSpec]
) -> Iterator[tuple[str, Figure]]:
    """The first problems of every family, as many as are named, each solved by :func:`page_arms`.

    Raises:
        SamplerError: a sampler does not answer.
    """
    shown, by_name = page_arms(arms), {spec.name: spec for spec in specs}
    if not any(problems.values()):
        return
    with opened(specs, setting.world) as sources:
        for family, index in ((name, index) for name, count in problems.items() for index in range(count)):
            problem, panels = known_problem(setting.world, family, setting.split, setting.seed, index), []
            for arm in shown:
                settings, batch = setting.planner(arm, index, 0), None
                if arm.sampler is not None:
                    spec = by_name[arm.sampler]
                    batch = ask(sources[arm.sampler], spec, problem, arm.query(settings.seed))
                samples = None if batch is None else batch.samples
                result = solve(problem, settings, samples, 1.0 - arm.learned_share, keep_tree=True)
                panels.append((arm, result, batch))
            yield f"page-{family}-{index:02d}", page(problem, panels, f"{family}, problem {index}")


def page(
    problem: Problem, panels: Sequence[tuple[Arm, PlanResult, SampleBatch | None]], title: str
) -> Figure:
    """One problem, solved by some arms; the workspace shows the path of the last one."""
    figure = _figure(4.3 * (2 + len(panels)), 5.2, 100)
    axes = figure.subplots(1, 2 + len(panels))
    simulator_of(problem.scenario.world).draw_picture(axes[0], np.asarray(picture_of(problem.scenario)))
    axes[0].set_title("the picture that the sampler sees\n", fontsize=10)
    arm, result, _ = panels[-1]
    plot_workspace(axes[1], problem, result.path)
    axes[1].set_title(f"workspace, path of\n{arm.name}" if result.solved else "workspace\n", fontsize=10)
    for one, (arm, result, batch) in zip(axes[2:], panels, strict=True):
        plot_configurations(one, problem, result, None if batch is None else batch.samples, (0, 1))
        outcome = f"{result.reason} ({result.iterations})"
        if result.solved:
            checks = f"{result.iterations} iterations, {result.edge_checks} edges"
            outcome = f"{checks}, {result.length_rad:.2f} rad"
        one.set_title(f"{arm.name}\n{outcome}", fontsize=10)
    figure.suptitle(", ".join(filter(None, (title, problem.passage))))
    marks = (("start", START, "o"), ("goal", GOAL, "D"), ("learned samples", LEARNED, "."))
    handles = [Line2D([], [], ls="", marker=mark, color=colour, label=name) for name, colour, mark in marks]
    lines = (("search tree", TREE, 1.0), ("path", PATH, 2.4))
    handles += [Line2D([], [], color=colour, lw=width, label=name) for name, colour, width in lines]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure
