"""What a head knows of configurations that depth pictures do not show whole, beside what the pictures say.

    python -m benchmarks.spatial.head_quality GRAPHS [--cameras 2]
        [--split test --problems FOLDER | --own 20 [--arm ur5]]

GRAPHS is a folder with a head's map.onnx and validity.onnx, such as a bundle. On each problem of
MotionBenchMaker, seen once with noise by cameras that are placed by chance as for training: half of the
configurations uniform, half about start and goal (sigma 0.3 rad). The truth is that of the spheres. Beside
the head stands the cloud: no sphere touches a surface that is seen, nor another sphere, and what is not seen
is free; once as it is, and once with the slack that makes it most accurate on these very problems. Test
problems are for figures that are reported, once. With --own the problems are those of the project's own
families, of which training sees others. One process, minutes.

Means over problems with 95 % bootstrap intervals over them. Near contact is within 2 cm of an obstacle, with
an arm that does not touch itself. False free is the share in collision of what passes, with as many refused
as that cloud refuses over all.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.bundle.runtime import Graph
from cspace.simulator import Split
from cspace.worlds.spatial.arm import SerialArm
from cspace.worlds.spatial.benchmark import LIMITS_RAD, BenchProblem, problems
from cspace.worlds.spatial.bodies import clearance_m
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.furniture import FAMILIES, Layout, SpatialScenes
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.problems import SpatialProblem, draw_problem
from cspace.worlds.spatial.scenes import seen
from cspace.worlds.spatial.visibility import lookup
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual
from services.evaluator.statistics import bootstrap_interval, mean_interval, ratio_of_sums_interval

NEAR_M, SIGMA_RAD, BINS = 0.02, 0.3, 15
UNSEEN = (0.0, 0.5, 0.7, 0.8, 0.9, 1.01)
SLACKS_M = tuple(0.0025 * step for step in range(-8, 17))


class Head:
    """A head's graphs."""

    def __init__(self, folder: Path, world: SpatialWorld) -> None:
        self.world = world
        self.map = Graph("map.onnx", (folder / "map.onnx").read_bytes(), {"image"}, {"map"})
        self.validity = Graph(
            "validity.onnx",
            (folder / "validity.onnx").read_bytes(),
            {"image", "map", "configurations"},
            {"confidence", "unseen"},
        )

    def confidence(self, picture: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        image = self.world.sensor.to_network(picture[None])
        known = self.map.run({"image": image}, {"map": self.map.fixed_shape("map")})["map"]
        feeds = {"image": image, "map": known, "configurations": rows}
        shape = (len(rows),)
        found = self.validity.run(feeds, {"confidence": shape, "unseen": shape})
        return found["confidence"], found["unseen"]


@dataclass(frozen=True)
class OwnProblem:
    """A problem of one of the project's own families."""

    family: str
    number: int
    problem: SpatialProblem

    @property
    def obstacles(self) -> Obstacles:
        return self.problem.layout.obstacles

    @property
    def start(self) -> np.ndarray:
        return self.problem.start

    @property
    def goal(self) -> np.ndarray:
        return self.problem.goal

    def layout(self, arm: SerialArm) -> Layout:
        del arm
        return self.problem.layout


def own_problems(world: SpatialWorld, split: Split, count: int, seed: int) -> list[OwnProblem]:
    """So many of each family."""
    scenes = world.scenes or SpatialScenes()
    return [
        OwnProblem(family, index, draw_problem(world.body, scenes, split, seed, index, family))
        for family in FAMILIES
        for index in range(count)
    ]


class Evaluated:
    """Configurations of one problem, by truth, head and cloud."""

    def __init__(
        self, head: Head, problem: BenchProblem | OwnProblem, cameras: int, count: int, seed: int
    ) -> None:
        views = replace(head.world.sensor.views, count=(cameras, cameras))
        sensor = replace(head.world.sensor, views=views, holes=0.0)
        world = replace(head.world, sensor=sensor)
        arm, self.family = world.body, problem.family
        rng = np.random.default_rng([seed, cameras, *problem.family.encode(), problem.number])
        scene = seen(rng, world, problem.layout(arm), np.array(problem.start))
        picture = world.observed(scene.view())
        ends = np.array([problem.start, problem.goal])[np.arange(count // 2) % 2]
        about = world.space.bound(ends + rng.normal(0.0, SIGMA_RAD, ends.shape))
        rows = np.concatenate([world.space.sample_uniform(rng, count - len(about)), about])
        stored = world.space.to_float32(rows)
        moving = arm.sphere_links() > 0
        spheres, radii = arm.sphere_centres_m(stored)[:, moving], arm.spheres_m()[moving, 3]
        self.itself = CollisionChecker(arm, Obstacles()).clearance(stored) > 0.0
        away = clearance_m(problem.obstacles, spheres, radii)
        self.free, self.near = self.itself & (away > 0.0), self.itself & (np.abs(away) < NEAR_M)
        self.confidence, self.unseen = head.confidence(picture, stored)
        margins = lookup(picture, world.sensor.grid, spheres).distance_m - radii
        self.margin = margins.min(axis=1)

    def cloud(self, slack_m: float = 0.0) -> np.ndarray:
        return self.itself & (self.margin > -slack_m)


def report(evaluated: list[Evaluated], rng: np.random.Generator) -> list[str]:
    best_m = max(
        SLACKS_M, key=lambda slack: np.mean([(one.cloud(slack) == one.free).mean() for one in evaluated])
    )
    predictions = {
        "head": [one.confidence > 0.5 for one in evaluated],
        "cloud": [one.cloud() for one in evaluated],
        f"cloud, slack {1e3 * best_m:.1f} mm": [one.cloud(best_m) for one in evaluated],
    }
    lines = [
        f"{name:<24}accuracy {right(said, evaluated, rng)}, "
        f"near contact {right(said, evaluated, rng, near=True)}"
        for name, said in predictions.items()
    ]
    for name, said in list(predictions.items())[1:]:
        threshold = np.quantile(joined(evaluated, "confidence"), 1.0 - np.concatenate(said).mean())
        head = [one.confidence > threshold for one in evaluated]
        pair = f"head {false_free(head, evaluated, rng)}, {name} {false_free(said, evaluated, rng)}"
        lines.append(f"false free at equal refusal: {pair}")
    lines.append(f"calibration error of the head {calibration(evaluated, rng):.4f}")
    return [*lines, *by_family(evaluated), *by_unseen(evaluated)]


def right(
    said: list[np.ndarray], evaluated: list[Evaluated], rng: np.random.Generator, *, near: bool = False
) -> str:
    shares = []
    for rows, one in zip(said, evaluated, strict=True):
        chosen = one.near if near else np.ones_like(one.near)
        if chosen.any():
            shares.append((rows == one.free)[chosen].mean())
    return f"{mean_interval(shares, rng):.4f}"


def false_free(passes: list[np.ndarray], evaluated: list[Evaluated], rng: np.random.Generator) -> str:
    wrong = [float((said & ~one.free).sum()) for said, one in zip(passes, evaluated, strict=True)]
    return f"{ratio_of_sums_interval(wrong, [float(said.sum()) for said in passes], rng):.4f}"


def joined(evaluated: list[Evaluated], name: str) -> np.ndarray:
    return np.concatenate([getattr(one, name) for one in evaluated])


def calibration(evaluated: list[Evaluated], rng: np.random.Generator) -> object:
    """Expected calibration error over all, resampled over problems."""
    table = []
    for one in evaluated:
        place = np.minimum((one.confidence * BINS).astype(int), BINS - 1)
        gaps = np.bincount(place, one.confidence - one.free, BINS)
        table.append(np.append(gaps, len(place)))

    def error(rows: np.ndarray) -> np.ndarray:
        return np.abs(rows[..., :-1].sum(axis=-2)).sum(axis=-1) / rows[..., -1].sum(axis=-1)

    return bootstrap_interval(np.array(table), error, rng)


def by_family(evaluated: list[Evaluated]) -> list[str]:
    lines = ["family: accuracy of the head, of the cloud, free share"]
    for family in dict.fromkeys(one.family for one in evaluated):
        own = [one for one in evaluated if one.family == family]
        head = np.mean([((one.confidence > 0.5) == one.free).mean() for one in own])
        cloud = np.mean([(one.cloud() == one.free).mean() for one in own])
        lines.append(f"  {family:<20}{head:8.4f}{cloud:8.4f}{np.mean([one.free.mean() for one in own]):8.3f}")
    return lines


def by_unseen(evaluated: list[Evaluated]) -> list[str]:
    confidence, unseen, free = (joined(evaluated, name) for name in ("confidence", "unseen", "free"))
    cloud = np.concatenate([one.cloud() for one in evaluated])
    lines = ["share unseen: of all, accuracy of the head, of the cloud, mean confidence, free share"]
    for low, high in pairwise(UNSEEN):
        rows = (unseen >= low) & (unseen < high)
        if rows.any():
            right = ((confidence > 0.5) == free)[rows].mean(), (cloud == free)[rows].mean()
            columns = (rows.mean(), *right, confidence[rows].mean(), free[rows].mean())
            lines.append(
                f"  {low:.2f} to {min(high, 1.0):.2f}    " + " ".join(f"{one:7.4f}" for one in columns)
            )
    return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("graphs", type=Path)
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--problems", type=Path, help="the folder of the test problems")
    parser.add_argument("--own", type=int, default=0, help="problems of each of the project's own families")
    parser.add_argument("--arm", choices=("panda", "ur5"), default="panda", help="of those problems")
    parser.add_argument("--cameras", type=int, default=1)
    parser.add_argument("--configurations", type=int, default=1000, help="in each problem")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.arm != "panda" and not options.own:
        parser.error("MotionBenchMaker's problems are those of the Panda: name --own as well")
    arm = shipped(options.arm)
    head = Head(options.graphs, usual(arm.with_limits(LIMITS_RAD) if options.arm == "panda" else arm))
    found: Sequence[BenchProblem | OwnProblem]
    if options.own:
        found = own_problems(head.world, Split(options.split), options.own, options.seed)
    else:
        found = problems(Split(options.split), options.problems)
    evaluated = [Evaluated(head, one, options.cameras, options.configurations, options.seed) for one in found]
    print(machine())
    each = f"{options.cameras} cameras, {options.configurations} each"
    print(f"{len(evaluated)} {options.split} problems, {each}")
    print("\n".join(report(evaluated, np.random.default_rng(options.seed))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
