"""Pictures for people: what the sampler was shown, what is true, what it answered."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.evaluator.samplers import Sampler
from services.evaluator.scenes import Scene

GRID = 160
SHOWN_SAMPLES = 1000
FREE_COLOUR, COLLISION_COLOUR = "#1f77b4", "#d62728"


def gallery(scenes: Sequence[Scene], sampler: Sampler, title: str) -> Figure:
    """One row a scenario: the picture, the true free space, the samples with collisions marked.

    Of more than two joints the first two are shown.
    """
    figure = Figure(figsize=(8.4, 2.8 * len(scenes)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(scenes), 3, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        _picture(row[0], scene)
        _truth(row[1], scene)
        _samples(row[2], scene, sampler)
    figure.suptitle(title)
    return figure


def _picture(axes: Axes, scene: Scene) -> None:
    camera = scene.stage.camera
    axes.imshow(scene.image, extent=(camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m))
    axes.set_title(f"{scene.stage.split} scenario {scene.index}", fontsize=9)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _truth(axes: Axes, scene: Scene) -> None:
    if scene.space.dim == 2:
        free_map(axes, scene)
        axes.set_title("truth: grey is in collision", fontsize=9)
    else:
        real = scene.free(SHOWN_SAMPLES, scene.rng(7))
        axes.scatter(real[:, 0], real[:, 1], s=2, color=FREE_COLOUR, linewidths=0)
        axes.set_title("free configurations, joints 1 and 2", fontsize=9)
    _joint_axes(axes, scene)


def _samples(axes: Axes, scene: Scene, sampler: Sampler) -> None:
    drawn = np.asarray(sampler.sample(scene.image, SHOWN_SAMPLES, scene.sampler_seed()), dtype=np.float64)
    free = scene.checker.valid_batch(drawn)
    if scene.space.dim == 2:
        free_map(axes, scene)
    for mask, colour, size in ((free, FREE_COLOUR, 2), (~free, COLLISION_COLOUR, 5)):
        axes.scatter(drawn[mask, 0], drawn[mask, 1], s=size, color=colour, linewidths=0)
    axes.set_title(f"{len(drawn)} samples, {free.mean():.1%} free", fontsize=9)
    _joint_axes(axes, scene)


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
    axes.set_xlim(scene.space.lower[0], scene.space.upper[0])
    axes.set_ylim(scene.space.lower[1], scene.space.upper[1])
    axes.set_xlabel("theta1 [rad]")
    axes.set_ylabel("theta2 [rad]")
