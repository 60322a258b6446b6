"""A page for a problem: its picture, its workspace, and the configuration space as each sampler left it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cspace.problem import Problem
from cspace.worlds import picture_of, workshop_of
from services.evaluator.benchmark.runs.arms import DEFAULT_SHARE, Arm, Group
from services.evaluator.benchmark.runs.measure import known_problem
from services.evaluator.benchmark.runs.setting import Setting
from services.evaluator.benchmark.runs.sources import SourceSpec, ask, opened
from services.evaluator.evaluation.units import planner_seed
from services.planner.drawing import palette
from services.planner.drawing.configuration_panel import draw_configurations
from services.planner.drawing.workspace_panel import draw_workspace
from services.planner.search.ompl_planner import PlanResult, solve
from services.planner.settings import RRT
from services.planner.sources.samples import SampleBatch

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
