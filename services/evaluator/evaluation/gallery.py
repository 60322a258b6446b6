"""Pictures for people: what the sampler was shown, what is true, what it answered and where it erred."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cspace.problem import UNIFORM
from cspace.worlds import workshop_of
from services.evaluator.measures.nearest import covered
from services.evaluator.measures.samplers import unfiltered
from services.evaluator.measures.scenes import Scene
from services.planner.sources.samples import SampleSource

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


def gallery(
    scenes: Sequence[Scene], sampler: SampleSource, title: str, notes: Sequence[str] | None = None
) -> Figure:
    """One row a scenario: the picture, the true free space, the samples with both kinds of mistakes marked.

    A mistake is a sample in collision, or a free configuration that no sample is near. Of more than two
    joints the first two are shown, without the second kind, which a projection would hide.

    Args:
        scenes: what is shown.
        sampler: whose samples.
        title: of the whole.
        notes: words beside each scenario's name.
    """
    figure = Figure(figsize=(9.0, 0.7 + 2.9 * len(scenes)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(scenes), 3, squeeze=False)
    for row, scene, note in zip(panels, scenes, notes or [""] * len(scenes), strict=True):
        _picture(row[0], scene, note)
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


def _picture(axes: Axes, scene: Scene, note: str) -> None:
    workshop_of(scene.stage.world).draw_picture(axes, scene.image)
    family = "" if scene.family == UNIFORM else f"{scene.family} "
    name = f"{scene.stage.split}, {family}scenario {scene.index}"
    axes.set_title(f"{name}\n{note}" if note else name, fontsize=9)


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
        axes.scatter(
            *_plane(ends),
            s=50,
            marker="X",
            color=END_COLOUR,
            edgecolors="white",
            clip_on=False,
            zorder=3,
        )
    _joint_axes(axes, scene)


def _passage(scene: Scene) -> str:
    if scene.problem is None:
        return ""
    bottleneck_rad = scene.problem.bottleneck_rad
    return f"\nbottleneck {bottleneck_rad:.3f} rad" if bottleneck_rad > 0.0 else "\nno path"


def _samples(axes: Axes, scene: Scene, sampler: SampleSource) -> None:
    drawn = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
    free = scene.checker.valid_batch(drawn)
    held_out = scene.free(SHOWN_SAMPLES, scene.rng(0))
    reached = covered(held_out, drawn, scene.space, scene.measures.coverage_radius_rad)
    if scene.space.dim == 2:
        free_map(axes, scene)
        missed = held_out[~reached]
        axes.scatter(missed[:, 0], missed[:, 1], s=9, marker="s", color=MISSED_COLOUR, linewidths=0)
    for mask, colour, size in ((free, FREE_COLOUR, 2), (~free, COLLISION_COLOUR, 5)):
        axes.scatter(*_plane(drawn[mask]), s=size, color=colour, linewidths=0)
    shares = f"{free.mean():.1%} free, {reached.mean():.1%} covered"
    axes.set_title(f"{len(drawn)} samples\n{shares}", fontsize=9)
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
