"""Pictures of an evaluation: samples in single scenarios, and plans."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cspace.simulator import UNIFORM, Split
from cspace.worlds import picture_of, simulator_of
from services.evaluator.evaluation import UNIFORM_SHARE, Setting, learned_samples, planner_of, planner_seed
from services.evaluator.metrics.coverage import covered
from services.evaluator.scenes import Scene, unfiltered
from services.planner.ompl_planner import solve
from services.planner.plotting import plot_plan
from services.planner.samples import SampleSource

GRID = 160
SHOWN_SAMPLES = 1000
FREE_COLOUR, COLLISION_COLOUR, MISSED_COLOUR = "#1f77b4", "#d62728", "#ff9f1c"
END_COLOUR = "#2ca02c"
POINTS = (
    ("sample", FREE_COLOUR, "o", 3),
    ("sample in collision", COLLISION_COLOUR, "o", 4),
    ("free, no sample within {} rad", MISSED_COLOUR, "s", 4),
    ("start and goal of the family's problem", END_COLOUR, "X", 7),
)


def gallery(scenes: Sequence[Scene], sampler: SampleSource, title: str) -> Figure:
    """One row a scenario: the picture, the true free space, the samples with both kinds of mistakes marked.

    A mistake is a sample in collision, or a free configuration that no sample is near. Of more than two
    joints the first two are shown, without the second kind, which a projection would hide.
    """
    figure = Figure(figsize=(9.0, 0.7 + 2.9 * len(scenes)), dpi=110, layout="constrained")
    panels = figure.subplots(len(scenes), 3, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        _picture(row[0], scene)
        _truth(row[1], scene)
        _samples(row[2], scene, sampler)
    figure.suptitle(title)
    radius_rad = scenes[0].measures.coverage_radius_rad
    handles = [
        Line2D([], [], color=colour, marker=marker, markersize=size, ls="", label=label.format(radius_rad))
        for label, colour, marker, size in POINTS
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=8, frameon=False)
    return figure


def _picture(axes: Axes, scene: Scene) -> None:
    simulator_of(scene.stage.world).draw_picture(axes, scene.image)
    family = "" if scene.family == UNIFORM else f"{scene.family} "
    axes.set_title(f"{scene.stage.split}, {family}scenario {scene.index}", fontsize=9)


def _truth(axes: Axes, scene: Scene) -> None:
    if scene.space.dim == 2:
        free_map(axes, scene)
        axes.set_title(f"truth: grey is in collision{_passage(scene)}", fontsize=9)
    else:
        real = scene.free(SHOWN_SAMPLES, scene.rng(7))
        axes.scatter(*_plane(real), s=2, color=FREE_COLOUR, linewidths=0)
        shown = ", joints 1 and 2" if scene.space.dim > 1 else ""
        axes.set_title(f"free configurations{shown}", fontsize=9)
    if scene.problem is not None:
        ends = np.stack([scene.problem.start, scene.problem.goal])
        look: dict[str, Any] = {"marker": "X", "color": END_COLOUR, "edgecolors": "white"}
        axes.scatter(*_plane(ends), s=50, clip_on=False, zorder=3, **look)
    _joint_axes(axes, scene)


def _passage(scene: Scene) -> str:
    return "" if scene.problem is None else f"\n{scene.problem.passage}"


def _samples(axes: Axes, scene: Scene, sampler: SampleSource) -> None:
    samples = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
    free = scene.checker.valid_batch(samples)
    held_out = scene.free(SHOWN_SAMPLES, scene.rng(0))
    reached = covered(held_out, samples, scene.space, scene.measures.coverage_radius_rad)
    if scene.space.dim == 2:
        free_map(axes, scene)
        missed = held_out[~reached]
        axes.scatter(missed[:, 0], missed[:, 1], s=9, marker="s", color=MISSED_COLOUR, linewidths=0)
    for mask, colour, size in ((free, FREE_COLOUR, 2), (~free, COLLISION_COLOUR, 5)):
        axes.scatter(*_plane(samples[mask]), s=size, color=colour, linewidths=0)
    shares = f"{free.mean():.1%} free, {reached.mean():.1%} covered"
    axes.set_title(f"{len(samples)} samples\n{shares}", fontsize=9)
    _joint_axes(axes, scene)


def _plane(configurations: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The first two joints of (n, d), (n,) each; a single one lies on a line."""
    first = configurations[:, 0]
    return first, configurations[:, 1] if configurations.shape[1] > 1 else np.zeros_like(first)


def free_map(axes: Axes, scene: Scene) -> None:
    """White where free, grey in collision."""
    first, second = (
        np.linspace(low, high, GRID) for low, high in zip(scene.space.lower, scene.space.upper, strict=True)
    )
    grid: NDArray[np.float64] = np.stack(np.meshgrid(first, second), axis=-1).reshape(-1, 2)
    free = scene.checker.valid_batch(grid).reshape(GRID, GRID)
    extent = (first[0], first[-1], second[0], second[-1])
    axes.imshow(free, extent=extent, origin="lower", cmap="gray", vmin=-2.0, vmax=1.0, aspect="auto")


def _joint_axes(axes: Axes, scene: Scene) -> None:
    space = scene.space
    for joint, axis in enumerate((axes.xaxis, axes.yaxis)[: space.dim]):
        if space.periodic[joint]:
            axis.set_ticks([-np.pi, 0.0, np.pi], labels=["-\u03c0", "0", "\u03c0"])
        axis.set_label_text(f"theta{joint + 1} [rad]")
    axes.set_box_aspect(1.0)
    axes.set_xlim(space.lower[0], space.upper[0])
    if space.dim > 1:
        axes.set_ylim(space.lower[1], space.upper[1])
    else:
        axes.yaxis.set_ticks([])


def plan_figure(setting: Setting, family: str, index: int, sampler: SampleSource, title: str) -> Figure:
    """A test problem, solved with a path model's samples."""
    problem = simulator_of(setting.world).problem(family, Split.TEST, setting.seed, index)
    seed = planner_seed(setting.seed, 0, 0)
    samples = learned_samples(problem, picture_of(problem.scenario), seed, sampler)
    settings = replace(planner_of(setting.world), seed=seed)
    plan = solve(problem, settings, samples, UNIFORM_SHARE, keep_tree=True)
    return plot_plan(problem, plan, samples, f"{title}, {family}")
