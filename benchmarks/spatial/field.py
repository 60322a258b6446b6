"""Plans in level sets of the field of space, beside a bundle's, in MotionBenchMaker's validation problems.

    python -m benchmarks.spatial.field CHECKPOINT BUNDLE [--problems 30] [--pictures 1]

CHECKPOINT is `last.ckpt` of `python -m training.field`. Worlds are what is seen and all unseen voxels whose
probability of being occupied is above a level, the lowest level first. RRT-Connect searches each world with
all of its states before the next, at first 1 cm away from obstacles. Unseen voxels in which the arm is at
start and goal are free. Paths are checked every 0.01 rad. With --truth the field is the true occupancy.

Printed: share solved and share that collide, of both, and their paired difference with a 95 % bootstrap
interval over problems; by level, how many paths were found there and how many of these collide; times of the
search.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file
from scipy.ndimage import distance_transform_edt

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.bundle import load_verified
from cspace.bundle.runtime import Graph
from cspace.planning.paths import spaced
from cspace.planning.search import SearchLimits, find_paths
from cspace.simulator import Problem, ProblemRequest, Split
from cspace.worlds import checker_of, examples, partly_seen, picture_file_of
from cspace.worlds.spatial.benchmark import BENCH_FAMILIES, PREFIX
from cspace.worlds.spatial.checks import world_checkers
from cspace.worlds.spatial.scenes import SpatialScene
from cspace.worlds.spatial.sensor import FARTHEST, FREE, GridBox
from cspace.worlds.spatial.visibility import distances_m
from services.evaluator.benchmark.sources import plan_query
from services.evaluator.statistics import mean_interval
from training.field import SCENE_MODEL, occupancy, varied
from training.models.field import field_graph, new_field
from training.scene_model import SIZES, TRAINED, named_arm, scene_world

LEVELS, MARGINS_M = (0.05, 0.15, 0.3, 0.5, 0.8), (0.01, 0.0)
FULL = SearchLimits(first=4096, search_rad=0.03, shortcut_rad=0.01)
FAR_M, LOOK_RAD = 0.5, 0.01


@dataclass(frozen=True)
class Compared:
    """One problem: clearance of either plan, None without one; the level, and the time of its search."""

    field_m: float | None
    bundle_m: float | None
    level: int
    search_s: float


def opened_field(checkpoint: Path) -> Graph:
    """The field's graph, from a training's checkpoint."""
    world = varied(scene_world(named_arm(TRAINED)))
    net = new_field(SIZES, world, load_file(SCENE_MODEL))
    weights = torch.load(checkpoint, weights_only=True)["state_dict"]
    net.load_state_dict({name.removeprefix("net."): value for name, value in weights.items()})
    grid = world.sensor.grid
    return Graph("field.onnx", field_graph(net, grid.counts, grid.low_m), {"image"}, {"occupancy"})


def scene_of(problem: Problem) -> SpatialScene:
    """The scene of an arm in space."""
    return cast("SpatialScene", problem.scenario)


def away_from(
    centres_m: NDArray[np.float64], radii_m: NDArray[np.float64], grid: GridBox
) -> NDArray[np.float64]:
    """From voxels' centres to the nearest of some spheres, (X, Y, Z) m; inf farther than two voxels."""
    found, low = np.full(grid.counts, np.inf), np.asarray(grid.low_m)
    places = grid.centres_m()
    for centre, radius in zip(centres_m, radii_m, strict=True):
        reach = radius + 2.0 * grid.voxel_m
        first = np.clip(np.floor((centre - reach - low) / grid.voxel_m), 0, None).astype(int)
        last = np.clip(np.ceil((centre + reach - low) / grid.voxel_m), 0, None).astype(int)
        part = tuple(slice(*span) for span in zip(first, last, strict=True))
        away = np.linalg.norm(places[part] - centre, axis=-1) - radius
        found[part] = np.minimum(found[part], away)
    return found


def level_worlds(
    picture: NDArray[np.uint8],
    probability: NDArray[np.float32],
    grid: GridBox,
    known_free: NDArray[np.bool_],
) -> Iterator[NDArray[np.float32]]:
    """Distances (X, Y, Z) m in each level set, that of the lowest level first, and to what is seen alone."""
    seen = np.where(picture[..., 0] == FARTHEST, np.float32(FAR_M), distances_m(picture))
    unsure = (picture[..., 1] != FREE) & ~known_free
    for level in LEVELS:
        occupied = unsure & (probability > level)
        hidden = distance_transform_edt(~occupied) * grid.voxel_m if occupied.any() else FAR_M
        yield np.minimum(np.minimum(seen, hidden), FAR_M).astype(np.float32)
    yield seen


def searched(
    problem: Problem, picture: NDArray[np.uint8], probability: NDArray[np.float32], room_m: float
) -> tuple[NDArray[np.float64] | None, int]:
    """A path and the level that it was found in."""
    world, ends = scene_of(problem).world, np.stack([problem.start, problem.goal])
    arm, grid = world.body, world.sensor.grid
    moving = arm.sphere_links() > 0
    centres = arm.sphere_centres_m(ends)[:, moving].reshape(-1, 3)
    radii = np.tile(arm.spheres_m()[moving, 3], len(ends))
    known_free = away_from(centres, radii, grid) <= room_m
    for level, away in enumerate(level_worlds(picture, probability, grid, known_free)):
        checkers = world_checkers(arm, [away - np.float32(margin) for margin in MARGINS_M], grid, ends)
        for checker in checkers:
            found = find_paths([checker], problem.start, problem.goal, 1, 0, np.inf, limits=FULL)
            for path in found.paths:
                if checker.edge_batch(path[:-1], path[1:], LOOK_RAD).all():
                    return path, level
    return None, -1


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--problems", type=int, default=30, help="of each family")
    parser.add_argument("--pictures", type=int, default=1)
    parser.add_argument("--room", type=float, default=0.03, help="free about the arm at both ends, m")
    parser.add_argument("--truth", action="store_true")
    options = parser.parse_args()
    field, bundle = opened_field(options.checkpoint), load_verified(options.bundle)
    problems_of = partly_seen(examples()[TRAINED])
    compared = []
    for family in BENCH_FAMILIES:
        for index in range(options.problems):
            request = ProblemRequest(Split.VALIDATION)
            problem = problems_of.problem(request, PREFIX + family, index, options.pictures)
            if problem is None:
                continue
            scene, truth = scene_of(problem), checker_of(problem.scenario)
            world = scene.world
            examined = world.examine_picture(picture_file_of(scene))
            picture = examined.images[0]
            if options.truth:
                probability = occupancy(world, scene.obstacles).astype(np.float32)
            else:
                image = world.sensor.to_network(picture[None])
                probability = field.run({"image": image}, {"occupancy": world.sensor.grid.counts})[
                    "occupancy"
                ]
            began = time.perf_counter()
            path, level = searched(problem, picture, probability, options.room)
            took_s = time.perf_counter() - began
            own = bundle.within(world)
            plan = own.plan(own.prepare(examined), plan_query(problem, 0, 2.0))
            clearances = [
                None if one is None else float(truth.clearance(spaced(one, problem.space, LOOK_RAD)).min())
                for one in (path, plan.path if plan.status == "solved" else None)
            ]
            compared.append(Compared(clearances[0], clearances[1], level, took_s))
    print(f"{machine()}\n{report(compared)}")
    return 0


def report(compared: list[Compared]) -> str:
    """Lines of figures."""
    rng, lines = np.random.default_rng(0), []
    for name in ("field_m", "bundle_m"):
        found = [value for one in compared if (value := getattr(one, name)) is not None]
        share = mean_interval([float(value <= 0.0) for value in found], rng)
        lines.append(f"{name[:-2]}: solved {len(found)} of {len(compared)}, collide {share:.3f}")
    both = [(one.field_m, one.bundle_m) for one in compared]
    more = [float(a <= 0.0) - float(b <= 0.0) for a, b in both if a is not None and b is not None]
    lines.append(f"difference {mean_interval(more, rng):.3f}")
    for level in range(len(LEVELS) + 1):
        own = [one.field_m for one in compared if one.level == level and one.field_m is not None]
        name = f"P > {LEVELS[level]:g}" if level < len(LEVELS) else "what is seen"
        lines.append(f"{name}: {len(own)} paths, {sum(value <= 0.0 for value in own)} collide")
    times_ms = 1e3 * np.array([one.search_s for one in compared])
    lines.append(f"search {np.median(times_ms):.0f} ms, p95 {np.quantile(times_ms, 0.95):.0f} ms")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
