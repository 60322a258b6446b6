"""The two pictures of a study: how the columns converge, and how they reconstruct a free space."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.evaluator.figures import COLLISION_COLOUR, FREE_COLOUR, SHOWN_SAMPLES, free_map
from services.evaluator.measure import sample_clouds
from services.evaluator.scenes import Scene, Stage, unfiltered
from services.planner.samples import SampleSource

# Okabe and Ito's palette, told apart by the colour-blind, too.
COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
LOSSES = {"wasserstein_estimate": "Wasserstein estimate", "generator_loss": "generator loss"}
QUALITIES = {"precision": "precision", "coverage": "coverage", "edr": "EDr"}
SMOOTHED_ROWS = 15

Measured = Mapping[str, Any]


def convergence(curves: Mapping[str, Measured], uniform: Mapping[str, float]) -> Figure:
    """Losses in training, and quality on validation scenarios at every snapshot, one line a column.

    Args:
        curves: by label, what :func:`benchmarks.paper.measures.learning_curve` returns.
        uniform: what uniform samples reach, by measure.
    """
    figure = Figure(figsize=(11.0, 6.2), layout="constrained")
    panels = figure.subplots(2, 3)
    for axes, (name, title) in zip(panels[0], LOSSES.items(), strict=False):
        _loss_panel(axes, curves, name)
        axes.set_title(title, fontsize=11)
    _key(panels[0][2], curves)
    for axes, (name, title) in zip(panels[1], QUALITIES.items(), strict=True):
        _quality_panel(axes, curves, name, uniform[name])
        axes.set_title(f"{title}, unseen validation scenarios", fontsize=11)
    for axes in (*panels[0][:2], *panels[1]):
        axes.set_xlabel("generator step")
        axes.grid(visible=True, alpha=0.3)
    return figure


def reconstruction(scenes: Sequence[Scene], samplers: Mapping[str, SampleSource], draws: int) -> Figure:
    """One row a scenario: its picture, real samples, each sampler's with its collisions marked and its GS-C.

    Args:
        scenes: with two joints.
        samplers: by label.
        draws: of landmarks for GS-C.
    """
    count = len(samplers) + 2
    figure = Figure(figsize=(2.15 * count, 2.75 * len(scenes) + 0.4), layout="constrained")
    panels = figure.subplots(len(scenes), count, squeeze=False)
    for row, scene in zip(panels, scenes, strict=True):
        _picture(row[0], scene)
        real, floor = scene.free(SHOWN_SAMPLES, scene.rng(7)), 0.0
        for axes, sampler in zip(row[2:], samplers.values(), strict=True):
            samples = unfiltered(sampler, scene.image, SHOWN_SAMPLES, scene.sampler_seed())
            score, floor = sample_clouds(scene, sampler, draws).complement_scores[0]
            _cloud(axes, scene, samples, score)
        _cloud(row[1], scene, real, floor)
        row[1].set_ylabel("theta2 [rad]")
    for axes, label in zip(panels[0], ("picture", "real samples", *samplers), strict=True):
        axes.set_title(label.replace(", ", ",\n"), fontsize=10)
    note = (
        f"{SHOWN_SAMPLES} samples for one picture: blue is free, red in collision; the ground shows the truth"
    )
    figure.suptitle(note, fontsize=11)
    return figure


def typical(stage: Stage, among: int = 21) -> Scene:
    """The scenario whose free share is the median of the first ones, so that nobody picks what is shown."""
    scenes = [Scene(stage, index) for index in range(among)]
    shares = [
        float(scene.checker.valid_batch(scene.space.sample_uniform(scene.rng(8), SHOWN_SAMPLES)).mean())
        for scene in scenes
    ]
    return scenes[int(np.argsort(shares, kind="stable")[among // 2])]


def _loss_panel(axes: Axes, curves: Mapping[str, Measured], name: str) -> None:
    for colour, curve in zip(COLOURS, curves.values(), strict=False):
        steps, values = (np.array([row[key] for row in curve["losses"]]) for key in ("step", name))
        axes.plot(steps, values, color=colour, alpha=0.2, linewidth=0.7)
        axes.plot(steps, _smooth(values), color=colour, linewidth=1.5)


def _quality_panel(axes: Axes, curves: Mapping[str, Measured], name: str, uniform: float) -> None:
    for colour, curve in zip(COLOURS, curves.values(), strict=False):
        steps = [row["step"] for row in curve["quality"]]
        low, middle, high = (
            np.array([row[name][key] for row in curve["quality"]]) for key in ("low", "estimate", "high")
        )
        axes.plot(steps, middle, color=colour, marker="o", markersize=4, linewidth=1.5)
        axes.fill_between(steps, low, high, color=colour, alpha=0.12, linewidth=0)
    axes.axhline(uniform, color="0.4", linestyle="--", linewidth=1.2)


def _key(axes: Axes, curves: Mapping[str, Measured]) -> None:
    """The legend in a panel of its own."""
    axes.axis("off")
    lines = [
        axes.plot([], [], color=colour, linewidth=2.0)[0] for colour, _ in zip(COLOURS, curves, strict=False)
    ]
    uniform = axes.plot([], [], color="0.4", linestyle="--", linewidth=1.2)[0]
    axes.legend(
        [*lines, uniform],
        [*curves, "uniform samples"],
        loc="center left",
        frameon=False,
        fontsize=11,
        title="thin: as logged; thick: running mean\nbands: 95 % over scenarios",
        title_fontsize=9,
        alignment="left",
    )


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Running mean whose window is shorter at the ends."""
    window = np.ones(min(SMOOTHED_ROWS, len(values)))
    sums, counts = (np.convolve(row, window, mode="same") for row in (values, np.ones(len(values))))
    smooth: NDArray[np.float64] = sums / counts
    return smooth


def _picture(axes: Axes, scene: Scene) -> None:
    camera = scene.stage.world.sensor
    axes.imshow(scene.image, extent=(camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m))
    axes.set_xlabel("x [m]")
    seen = "training" if scene.stage.split == "train" else "unseen"
    axes.set_ylabel(f"{seen} scenario\ny [m]")


def _cloud(axes: Axes, scene: Scene, samples: NDArray[np.float64], score: float) -> None:
    free = scene.checker.valid_batch(samples)
    free_map(axes, scene)
    for mask, colour, size in ((free, FREE_COLOUR, 3), (~free, COLLISION_COLOUR, 5)):
        axes.scatter(samples[mask, 0], samples[mask, 1], s=size, color=colour, linewidths=0)
    axes.set_xlim(scene.space.lower[0], scene.space.upper[0])
    axes.set_ylim(scene.space.lower[1], scene.space.upper[1])
    axes.set_xticks([-2, 0, 2])
    axes.set_yticks([-2, 0, 2])
    axes.set_aspect("equal")
    axes.set_xlabel(f"theta1 [rad]\n{free.mean():.1%} free\nGS-C {1e4 * score:.1f}e-4", fontsize=10)
