"""Draws ``docs/images/space.png``: a depth picture, the space it shows, what a model predicts of the rest.

python docs/make_space_overview.py
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.errors import CspaceError
from cspace.simulator import Problem, Split
from cspace.worlds import checker_of, picture_file_of, simulator_of
from cspace.worlds.spatial.view import DepthView, read_view
from services.planner.plotting import GOAL, PATH, START

ROOT = Path(__file__).parents[1]
FAMILY, SEED = "shelf", 12
CONFIGURATIONS = 600
SIGMA_RAD = 0.3
DEFAULT_THRESHOLD = 0.5


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, look, ask, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--bundle", type=Path, default=ROOT / "inference_api" / "pretrained_panda", help="default %(default)s"
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "images", help="default %(default)s")
    options = parser.parse_args(arguments)
    try:
        bundle = Bundle.load(options.bundle)
        world = bundle.spec.world
        problem = simulator_of(world).problem(FAMILY, Split.DEMO, SEED)
        view = read_view(picture_file_of(problem.scenario), world.body)
        seen = world.read_picture(picture_file_of(problem.scenario))
        rows = about(problem, np.random.default_rng(SEED))
        confidence, unseen = bundle.predict(seen, rows)
    except CspaceError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    free = checker_of(problem.scenario).valid_batch(rows)
    threshold = bundle.spec.confidence_threshold or DEFAULT_THRESHOLD
    shares = confidence, np.zeros(len(rows)) if unseen is None else unseen
    figure = draw(problem, view, seen, (*shares, free), threshold)
    figure.savefig(options.folder / "space.png")
    passes = confidence >= threshold
    sys.stdout.write(
        f"{len(view.pictures)} pictures; {free.mean():.3f} of {len(rows)} are free, {passes.mean():.3f} pass "
        f"{threshold:g}, and {free[passes].mean():.3f} of these are free\n"
    )
    return 0


def about(problem: Problem, rng: np.random.Generator) -> NDArray[np.float32]:
    """Configurations about start and goal, where a planner asks."""
    space = problem.scenario.world.space
    ends = np.array([problem.start, problem.goal])[np.arange(CONFIGURATIONS) % 2]
    return space.to_float32(space.bound(ends + rng.normal(0.0, SIGMA_RAD, ends.shape)))


def draw(
    problem: Problem,
    view: DepthView,
    seen: NDArray[np.uint8],
    predictions: tuple[NDArray[np.float32], NDArray[np.floating], NDArray[np.bool_]],
    threshold: float,
) -> Figure:
    """Three panels: a picture, the space that it shows, and prediction against ground truth."""
    figure = Figure(figsize=(15.0, 4.8), dpi=110, layout="constrained")
    taken, shown, predicted = figure.subplots(1, 3)
    depth_m = np.where(view.pictures[0] > 0, view.pictures[0] * 1e-3, np.nan)
    image = taken.imshow(depth_m, cmap="viridis")
    figure.colorbar(image, ax=taken, label="depth (m)", shrink=0.8)
    taken.set(xlabel="column (pixels)", ylabel="row (pixels)")
    scene: Any = problem.scenario
    simulator = simulator_of(scene.world)
    simulator.draw_picture(shown, seen)
    simulator.draw_scene(shown, scene, "none")
    for configuration, colour in ((problem.start, START), (problem.goal, PATH)):
        simulator.draw_robot(shown, configuration, colour, 3)
    low, high = (np.asarray(one) for one in (scene.world.sensor.grid.low_m, scene.world.sensor.grid.high_m))
    shown.set(xlim=(low[0], high[0]), ylim=(low[2], high[2]))
    _predicted(predicted, *predictions, threshold)
    count = len(view.pictures)
    for axes, title in (
        (taken, f"one of {count} depth pictures; white has no reading" if count > 1 else "the depth picture"),
        (
            shown,
            "from the side: surfaces seen, space unseen in grey;\ntruth in outlines, start blue, goal orange",
        ),
        (predicted, f"{CONFIGURATIONS} configurations about start and goal"),
    ):
        axes.set_title(title, fontsize=10)
    return figure


def _predicted(
    axes: Any,
    confidence: NDArray[np.float32],
    unseen: NDArray[np.floating],
    free: NDArray[np.bool_],
    threshold: float,
) -> None:
    for rows, colour, marker, label in ((free, START, "o", "free"), (~free, GOAL, "x", "in collision")):
        axes.scatter(
            unseen[rows], confidence[rows], s=16, c=colour, marker=marker, linewidths=0.8, label=label
        )
    axes.axhline(threshold, color="black", linewidth=0.8, linestyle="--")
    axes.annotate(
        f"threshold {threshold:g}", (0.02, threshold - 0.04), xycoords=("axes fraction", "data"), fontsize=8
    )
    axes.set(
        xlabel="share of the arm in unseen space", ylabel="confidence that it is free", ylim=(-0.02, 1.02)
    )
    axes.legend(fontsize=8, loc="center right")


if __name__ == "__main__":
    sys.exit(main())
