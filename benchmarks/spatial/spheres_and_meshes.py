"""In how many configurations the Panda's spheres and its collision meshes disagree.

    python -m benchmarks.spatial.spheres_and_meshes

Needs the extra spatial. Three ways to draw, each for 210 groups of configurations: uniform within limits
without obstacles (self-collision alone), the same in each validation problem of MotionBenchMaker, and normal
around the start and the goal of each, clipped to the limits. Shares are means over groups with 95 % bootstrap
intervals over these, and medians; near is a clearance by spheres below 1 cm, inside or outside. Without
--urdf the description is that of the package example-robot-data. One process, about a minute.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

import cspace.worlds.spatial
from benchmarks.command import arguments
from cspace.splits import Split
from cspace.worlds.spatial.motionbench.problems import BenchProblem, problems
from cspace.worlds.spatial.obstacles.shapes import Obstacles
from cspace.worlds.spatial.obstacles.signed_distance import clearance_m
from cspace.worlds.spatial.partly_seen import FINGERS_M
from cspace.worlds.spatial.planning.judge import Description, RobotMeshes, panda_urdf
from cspace.worlds.spatial.robot.arm import SerialArm
from cspace.worlds.spatial.robot.kinematics import arm_arrays, self_distance_batch, sphere_centres_batch

NEAR_M = 0.01
RESAMPLES = 10_000
KINDS = (
    "spheres collide",
    "meshes collide",
    "near",
    "spheres alone, near",
    "spheres alone, far",
    "meshes alone, near",
    "meshes alone, far",
)
Draw = Callable[[np.random.Generator, BenchProblem, int], np.ndarray]


class Compared:
    """Verdicts of groups of configurations by both."""

    def __init__(self, arm: SerialArm, meshes: RobotMeshes) -> None:
        self.arm, self.arrays, self.meshes = arm, arm_arrays(arm), meshes
        self.shares: list[list[float]] = []
        self.gaps_m: dict[str, list[np.ndarray]] = {"spheres alone": [], "meshes alone": []}

    def add(self, obstacles: Obstacles, rows: np.ndarray) -> None:
        own = self_distance_batch(rows, self.arrays)
        outside = clearance_m(obstacles, sphere_centres_batch(rows, self.arrays), self.arrays.radii)
        spheres, judge = np.minimum(own, outside), self.meshes.among(obstacles)
        free = judge.valid_batch(rows)
        near, alone, missed = np.abs(spheres) < NEAR_M, (spheres <= 0.0) & free, (spheres > 0.0) & ~free
        told = (spheres <= 0.0, ~free, near, alone & near, alone & ~near, missed & near, missed & ~near)
        self.shares.append([float(one.mean()) for one in told])
        self.gaps_m["spheres alone"].append(judge.clearance_m(rows[alone]))
        self.gaps_m["meshes alone"].append(judge.clearance_m(rows[missed]))

    def lines(self, rng: np.random.Generator) -> list[str]:
        shares = 100.0 * np.array(self.shares)
        drawn = shares[rng.integers(len(shares), size=(RESAMPLES, len(shares)))].mean(axis=1)
        low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
        lines = []
        for at, name in enumerate(KINDS):
            interval = f"({low[at]:.3f} to {high[at]:.3f})"
            middle = np.median(shares[:, at])
            lines.append(f"  {name:<20}{shares[:, at].mean():9.3f} {interval:<20}{middle:9.3f}")
        for name, parts in self.gaps_m.items():
            gaps = 1e3 * np.concatenate(parts)
            found = (
                "none"
                if not len(gaps)
                else " ".join(f"{v:.2f}" for v in np.quantile(gaps, (0, 0.5, 0.95, 1)))
            )
            lines.append(
                f"  {name}: {len(gaps)}; clearance by meshes, mm, least, median, 95 %, most: {found}"
            )
        return lines


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--urdf", type=Path)
    parser.add_argument("--configurations", type=int, default=1000, help="in each group")
    parser.add_argument("--sigma-rad", type=float, default=0.3)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    arm = panda()
    held = dict.fromkeys(("panda_finger_joint1", "panda_finger_joint2"), FINGERS_M)
    meshes = RobotMeshes(arm, Description(options.urdf or panda_urdf() or parser.error("give --urdf"), held))
    space = arm.space

    def uniform(rng: np.random.Generator, _: BenchProblem, count: int) -> np.ndarray:
        return rng.uniform(space.lower, space.upper, (count, arm.dim))

    def around(rng: np.random.Generator, problem: BenchProblem, count: int) -> np.ndarray:
        ends = np.array([problem.start, problem.goal])[np.arange(count) % 2]
        return np.clip(ends + rng.normal(0.0, options.sigma_rad, (count, arm.dim)), space.lower, space.upper)

    cases: dict[str, tuple[Draw, bool]] = {
        "uniform, no obstacles": (uniform, False),
        "uniform, in problems": (uniform, True),
        f"within sigma {options.sigma_rad:g} rad of starts and goals": (around, True),
    }
    for case, (name, (draw, among)) in enumerate(cases.items()):
        compared = Compared(arm, meshes)
        for group, problem in enumerate(problems(Split.VALIDATION)):
            rng = np.random.default_rng([options.seed, case, group])
            compared.add(
                problem.obstacles if among else Obstacles(), draw(rng, problem, options.configurations)
            )
        print(
            f"{name}: {len(compared.shares)} x {options.configurations}; % of configurations, mean and median"
        )
        print("\n".join(compared.lines(np.random.default_rng(options.seed))), flush=True)
    return 0


def panda() -> SerialArm:
    """The robot that ships."""
    path = Path(cspace.worlds.spatial.__file__).with_name("robots") / "panda.json"
    return SerialArm.from_dict(json.loads(path.read_bytes()))


if __name__ == "__main__":
    sys.exit(main())
