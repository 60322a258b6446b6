"""What a head knows of configurations that depth pictures do not show whole, beside what the pictures say.

    python -m benchmarks.spatial.head_quality GRAPHS [--cameras 2] [--split test --problems FOLDER]

GRAPHS is a folder with a head's map.onnx and validity.onnx, such as a bundle. On each problem of
MotionBenchMaker, seen once with noise by cameras that are placed by chance as for training: half of the
configurations uniform, half about start and goal (sigma 0.3 rad). The truth is that of the spheres. Beside
the head stands the cloud: no sphere touches a surface that is seen, nor another sphere, and what is not seen
is free. Test problems are for figures that are reported, once. One process, minutes.

Means over problems with 95 % bootstrap intervals over them. Near contact is within 2 cm; false free is the
share in collision of what passes, with as many refused as the cloud refuses over all.
"""

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.spatial.spheres_and_meshes import panda
from cspace.bundle.running.graphs import Graph
from cspace.splits import Split
from cspace.worlds.spatial.motionbench.problems import BenchProblem, problems
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.planning.collision import CollisionChecker
from cspace.worlds.spatial.scene import seen
from cspace.worlds.spatial.seeing.observed import lookup
from cspace.worlds.spatial.world import SpatialWorld, usual
from services.evaluator.statistics import bootstrap_interval, mean_interval, ratio_of_sums_interval

NEAR_M, SIGMA_RAD, BINS = 0.02, 0.3, 15
UNSEEN = (0.0, 0.05, 0.2, 0.5, 1.01)


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
        known = self.map.run({"image": image}, {"map": self.map.sizes("map")})["map"]
        feeds = {"image": image, "map": known, "configurations": rows}
        shape = (len(rows),)
        found = self.validity.run(feeds, {"confidence": shape, "unseen": shape})
        return found["confidence"], found["unseen"]


class Judged:
    """Configurations of one problem, by truth, head and cloud."""

    def __init__(self, head: Head, problem: BenchProblem, cameras: int, count: int, seed: int) -> None:
        sensor = replace(head.world.sensor, views=replace(head.world.sensor.views, count=(cameras, cameras)))
        world = replace(head.world, sensor=sensor)
        arm, self.family = world.body, problem.family
        rng = np.random.default_rng([seed, cameras, *problem.family.encode(), problem.number])
        scene = seen(rng, world, problem.layout(arm), np.array(problem.start))
        picture = world.observed(scene.view())
        ends = np.array([problem.start, problem.goal])[np.arange(count // 2) % 2]
        about = world.space.bound(ends + rng.normal(0.0, SIGMA_RAD, ends.shape))
        rows = np.concatenate([world.space.sample_uniform(rng, count - len(about)), about])
        stored = world.space.to_float32(rows)
        self.clearance = CollisionChecker(arm, problem.obstacles).clearance(stored)
        self.free, self.near = self.clearance > 0.0, np.abs(self.clearance) < NEAR_M
        self.confidence, self.unseen = head.confidence(picture, stored)
        moving = arm.sphere_links() > 0
        spheres = arm.sphere_centres_m(stored)[:, moving]
        margin = lookup(picture, world.sensor.grid, spheres).distance_m - arm.spheres_m()[moving, 3]
        itself = CollisionChecker(arm, Obstacles()).clearance(stored) > 0.0
        self.cloud = (margin > 0.0).all(axis=1) & itself


def report(judged: list[Judged], rng: np.random.Generator) -> list[str]:
    every = {name: np.concatenate([getattr(one, name) for one in judged]) for name in ("confidence", "cloud")}
    # The head refuses as many as the cloud.
    threshold = float(np.quantile(every["confidence"], 1.0 - every["cloud"].mean()))

    def right(name: str, rows: str) -> str:
        shares = []
        for one in judged:
            said = one.confidence > 0.5 if name == "head" else one.cloud
            chosen = np.ones_like(one.near) if rows == "all" else one.near
            if chosen.any():
                shares.append((said == one.free)[chosen].mean())
        return f"{mean_interval(shares, rng):.4f}"

    def false_free(name: str) -> str:
        passes = [one.confidence > threshold if name == "head" else one.cloud for one in judged]
        wrong = [float((said & ~one.free).sum()) for said, one in zip(passes, judged, strict=True)]
        counts = [float(said.sum()) for said in passes]
        return f"{ratio_of_sums_interval(wrong, counts, rng):.4f}"

    lines = [f"{'':<34}{'head':<28}cloud"]
    for name, told in (
        ("accuracy", lambda who: right(who, "all")),
        ("accuracy within 2 cm of contact", lambda who: right(who, "near")),
        ("false free at equal refusal", false_free),
    ):
        lines.append(f"{name:<34}{told('head'):<28}{told('cloud')}")
    lines.append(f"calibration error of the head     {calibration(judged, rng):.4f}")
    return [*lines, *by_family(judged), *by_unseen(judged)]


def calibration(judged: list[Judged], rng: np.random.Generator) -> object:
    """Expected calibration error over all, resampled over problems."""
    table = []
    for one in judged:
        place = np.minimum((one.confidence * BINS).astype(int), BINS - 1)
        gaps = np.bincount(place, one.confidence - one.free, BINS)
        table.append(np.append(gaps, len(place)))

    def error(rows: np.ndarray) -> np.ndarray:
        return np.abs(rows[..., :-1].sum(axis=-2)).sum(axis=-1) / rows[..., -1].sum(axis=-1)

    return bootstrap_interval(np.array(table), error, rng)


def by_family(judged: list[Judged]) -> list[str]:
    lines = ["family: accuracy of the head, of the cloud, free share"]
    for family in dict.fromkeys(one.family for one in judged):
        own = [one for one in judged if one.family == family]
        head = np.mean([((one.confidence > 0.5) == one.free).mean() for one in own])
        cloud = np.mean([(one.cloud == one.free).mean() for one in own])
        lines.append(f"  {family:<20}{head:8.4f}{cloud:8.4f}{np.mean([one.free.mean() for one in own]):8.3f}")
    return lines


def by_unseen(judged: list[Judged]) -> list[str]:
    names = ("confidence", "unseen", "free", "cloud")
    confidence, unseen, free, cloud = (np.concatenate([getattr(o, name) for o in judged]) for name in names)
    lines = ["share unseen: of all, accuracy of the head, of the cloud, mean confidence, free share"]
    for low, high in pairwise(UNSEEN):
        rows = (unseen >= low) & (unseen < high)
        if rows.any():
            right = ((confidence > 0.5) == free)[rows].mean(), (cloud == free)[rows].mean()
            told = (rows.mean(), *right, confidence[rows].mean(), free[rows].mean())
            lines.append(f"  {low:.2f} to {min(high, 1.0):.2f}    " + " ".join(f"{one:7.4f}" for one in told))
    return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("graphs", type=Path)
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--problems", type=Path, help="the folder of the test problems")
    parser.add_argument("--cameras", type=int, default=1)
    parser.add_argument("--configurations", type=int, default=1000, help="in each problem")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    head = Head(options.graphs, usual(panda()))
    found = problems(Split(options.split), options.problems)
    judged = [Judged(head, one, options.cameras, options.configurations, options.seed) for one in found]
    print(machine())
    print(f"{len(judged)} {options.split} problems, {options.cameras} cameras, {options.configurations} each")
    print("\n".join(report(judged, np.random.default_rng(options.seed))))
    return 0


if __name__ == "__main__":
    sys.exit(main())
