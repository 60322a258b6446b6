"""Draws ``docs/images/overview.png``: a picture, its configuration space with samples, and a planned path.

python docs/make_overview.py
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cspace.bundle import Bundle, SampleSet
from cspace.errors import CspaceError
from cspace.files import encode_png
from cspace.simulator import Problem, Split
from cspace.worlds.planar.collision import CollisionChecker
from cspace.worlds.planar.problems import Family, draw_problem
from cspace.worlds.planar.simulator import render
from services.planner.ompl_planner import solve
from services.planner.plotting import GOAL, plot_configurations, plot_workspace
from services.planner.result import PlannerSettings, PlanResult

ROOT = Path(__file__).parents[1]
SAMPLES = 1000
PLANNED_WITH = 300
SEED = 17


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, sample, plan, draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--bundle", type=Path, default=ROOT / "inference_api" / "pretrained", help="default %(default)s"
    )
    parser.add_argument("--folder", type=Path, default=ROOT / "docs" / "images", help="default %(default)s")
    options = parser.parse_args(arguments)
    try:
        bundle = Bundle.load(options.bundle)
        problem = draw_problem(Family.UNIFORM, Split.DEMO, SEED, robot=bundle.spec.world.body)
        picture = render(problem.scenario)
        found = bundle.sample(picture, SAMPLES, SEED, min_confidence=0.0)
        rejected = _rejected(found, bundle.spec.confidence_threshold)
        samples = found.samples
        result = solve(problem, PlannerSettings(seed=SEED), samples[~rejected][:PLANNED_WITH])
    except CspaceError as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    (options.folder / "scenario.png").write_bytes(encode_png(picture))
    draw_overview(problem, picture, samples, rejected, result).savefig(options.folder / "overview.png")
    free = CollisionChecker(problem.scenario).valid_batch(samples)
    sys.stdout.write(
        f"{result.reason}, {result.iterations} iterations; {free.mean():.3f} of the samples are free, "
        f"{free[~rejected].mean():.3f} of the {np.sum(~rejected)} that are accepted\n"
    )
    return 0


def _rejected(found: SampleSet, threshold: float | None) -> NDArray[np.bool_]:
    """Which samples the model's own validity head would drop; none without a head."""
    if found.confidence is None or threshold is None:
        return np.zeros(len(found.samples), dtype=np.bool_)
    return found.confidence < threshold


def draw_overview(
    problem: Problem,
    picture: NDArray[np.uint8],
    samples: NDArray[np.float32],
    rejected: NDArray[np.bool_],
    result: PlanResult,
) -> Figure:
    """Three panels: what the model sees, what it generates, what the planner makes of it."""
    figure = Figure(figsize=(14.4, 5.0), dpi=110, layout="constrained")
    seen, generated, planned = figure.subplots(1, 3)
    camera = problem.scenario.camera
    seen.imshow(picture, extent=(camera.x_min_m, camera.x_max_m, camera.y_min_m, camera.y_max_m))
    seen.set(xlabel="x (m)", ylabel="y (m)")
    plot_configurations(generated, problem, result, samples[~rejected], (0, 1))
    generated.scatter(*samples[rejected].T, s=14, marker="x", color=GOAL, linewidths=0.8, zorder=2)
    plot_workspace(planned, problem, result.path)
    for axes, title in (
        (seen, "the picture"),
        (generated, f"{len(samples)} generated; crosses: below the threshold; grey: in collision"),
        (planned, f"RRT with {PLANNED_WITH} of the dots: {result.iterations} iterations"),
    ):
        axes.set_title(title, fontsize=10)
    return figure


if __name__ == "__main__":
    sys.exit(main())
