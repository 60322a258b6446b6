"""A planted shift: the Panda among MotionBenchMaker's cages, seen by a camera 40 cm higher than in training.

    python -m benchmarks.spatial.shift report --plans 240 --site cage
    python -m benchmarks.spatial.shift compare --problems FOLDER before=BUNDLE after=BUNDLE

`report` asks a server that runs with CSPACE_OUTCOMES_KEEP_DAYS for plans in the cages of the validation
problems, from ever other cameras, lets it keep them, checks each path and reports what became of it; it
prints when the evidence of drift reaches the alarm's, and the calibration error of the stated confidence.
`compare` takes the test problems, twice each, and problems of the project's own families, and prints for each
bundle the log loss of configurations, half of them about start and goal, the share of plans that collide and
the calibration error, with 95 % bootstrap intervals over problems, also of the difference to the first
bundle. The truth is that of the spheres.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import httpx
import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from benchmarks.spatial.head_quality import SIGMA_RAD, OwnProblem, own_problems
from benchmarks.spatial.problem_options import LIMIT_S, LOOK_RAD, PATHS
from cspace.bundle import Bundle
from cspace.errors import ImageError
from cspace.planning.cost import calibration_error
from cspace.planning.paths import length_rad, spaced
from cspace.query import PlanQuery
from cspace.simulator import Split
from cspace.worlds.spatial.benchmark import BenchProblem, problems, viewed, with_benchmark_limits
from cspace.worlds.spatial.camera import looking
from cspace.worlds.spatial.checks import CollisionChecker
from cspace.worlds.spatial.poses import pose_of
from cspace.worlds.spatial.scenes import SpatialScene, seen
from cspace.worlds.spatial.view import write_view
from cspace.worlds.spatial.world import SpatialWorld, shipped, usual
from cspace_client import OutcomeSender, SamplingClient
from cspace_client import PlanQuery as ClientQuery
from inference_api.drift import ALARM
from services.evaluator.statistics import difference_interval, log_losses, mean_interval

RAISED_M, SEED = 0.4, 25


@dataclass(frozen=True)
class Seen:
    """A problem whose ends are free, and what one camera sees of it."""

    start: np.ndarray
    goal: np.ndarray
    scene: SpatialScene
    truth: CollisionChecker

    @classmethod
    def of(
        cls,
        world: SpatialWorld,
        problem: BenchProblem | OwnProblem,
        rng: np.random.Generator,
        raised_m: float = 0.0,
    ) -> "Seen | None":
        layout = problem.layout(world.body)
        start, goal = np.array(problem.start), np.array(problem.goal)
        scene = seen(rng, viewed(world, 1), layout, start)
        (camera,) = scene.cameras
        place = np.array(camera.pose)[:3, 3] + (0.0, 0.0, raised_m)
        raised = replace(camera, pose=pose_of(looking(place, layout.focus)))
        scene = replace(scene, cameras=(raised,) if raised_m else scene.cameras)
        truth = CollisionChecker(world.body, problem.obstacles)
        fits = world.space.contains(np.array([start, goal])).all() and truth.valid_batch([start, goal]).all()
        try:
            world.examined(scene.view())
        except ImageError:
            return None
        return cls(start, goal, scene, truth) if fits else None

    def collided_at(self, path: np.ndarray) -> float | None:
        """The share of a path's length where it first collides."""
        states = spaced(path, self.scene.world.space, LOOK_RAD)
        hit = np.flatnonzero(~self.truth.valid_batch(states))
        if not len(hit):
            return None
        space = self.scene.world.space
        return length_rad(states[: hit[0] + 1], space) / length_rad(states, space)


def cages(world: SpatialWorld, split: Split, folder: Path | None, seed: int = SEED) -> Iterator[Seen]:
    """The cages, again and again, from ever other sides."""
    found, turn = problems(split, folder, families=("cage",)), 0
    while True:
        for problem in found:
            one = Seen.of(world, problem, np.random.default_rng([seed, turn, problem.number]), RAISED_M)
            if one is not None:
                yield one
        turn += 1


def report(options: argparse.Namespace) -> None:
    """Ask, check and report."""
    world, alarm = usual(shipped("panda")), None
    confidence, free = [], []
    with SamplingClient(options.url, 60.0) as client, OutcomeSender(options.url) as sender:
        for number, one in enumerate(cages(world, Split.VALIDATION, None, options.seed)):
            if len(free) == options.plans:
                break
            ends = one.start.tolist(), one.goal.tolist()
            query = ClientQuery(
                *ends, number, 0.0, LIMIT_S, PATHS, site=options.site, keep=not options.forget
            )
            found = client.plan(write_view(one.scene.view()), query, options.model)
            if found.plan.status != "solved":
                continue
            at = one.collided_at(np.array(found.plan.path))
            sender.plan(found, success=at is None, collided=at is not None, collided_at=at, site=options.site)
            confidence.append(found.plan.confidence)
            free.append(at is None)
            if alarm is None and evidence(options.url) >= ALARM:
                alarm = len(free)
                print(f"the alarm came within {alarm} outcomes", flush=True)
            if len(free) % 20 == 0:
                print(f"{len(free)} plans, {free.count(False)} collide", flush=True)
    stated, rng = np.array(confidence), np.random.default_rng(0)
    exact = np.mean([calibration_error(stated, rng.random(len(stated)) < stated) for _ in range(200)])
    error = calibration_error(stated, free)
    print(f"calibration error {error:.3f}, by {found.calibration or 'the model'}; were it exact {exact:.3f}")


def evidence(url: str) -> float:
    """Of drift, as the server states it."""
    lines = httpx.get(f"{url}/metrics").raise_for_status().text.splitlines()
    name = "cspace_collision_evidence "
    return max((float(line.split()[1]) for line in lines if line.startswith(name)), default=0.0)


def compare(options: argparse.Namespace) -> None:
    """Print what bundles predict, in the shifted scenes and in those of the project's own families."""
    pairs = [text.partition("=") for text in options.bundles]
    bundles = {name: Bundle.load(Path(folder)) for name, _, folder in pairs}
    world = with_benchmark_limits(usual(shipped("panda")))
    some = cages(world, Split.TEST, options.problems)
    own = own_problems(world, Split.TEST, options.own, SEED)
    sets = {
        "raised cages": [one for one, _ in zip(some, range(2 * options.cages), strict=False)],
        "own families": [
            one
            for problem in own
            if (one := Seen.of(world, problem, np.random.default_rng([SEED, problem.number]))) is not None
        ],
    }
    rng = np.random.default_rng(0)
    for title, chosen in sets.items():
        columns = {name: measured(bundle.within(world), chosen) for name, bundle in bundles.items()}
        first = next(iter(columns.values()))
        print(f"{title}: {len(chosen)} views of problems")
        for name, (losses, hits, confidence) in columns.items():
            error = calibration_error(confidence, ~hits)
            print(
                f"  {name}: log loss {mean_interval(losses, rng):.4f}, "
                f"collide {mean_interval(hits.astype(float), rng):.3f}, calibration error {error:.3f}"
            )
            if losses is not first[0]:
                less = difference_interval(first[0], losses, rng)
                fewer = difference_interval(first[1].astype(float), hits.astype(float), rng)
                print(f"    less than the first: log loss {less:.4f}, collide {fewer:.3f}", flush=True)


def measured(bundle: Bundle, chosen: list[Seen]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean log loss of configurations, whether the plan collides, and its confidence, of each."""
    losses, hits, confidences = [], [], []
    for number, one in enumerate(chosen):
        space = bundle.spec.world.space
        rng = np.random.default_rng([SEED, 2, number])
        ends = np.array([one.start, one.goal])[np.arange(200) % 2]
        about = space.bound(ends + rng.normal(0.0, SIGMA_RAD, ends.shape))
        rows = space.to_float32(np.concatenate([space.sample_uniform(rng, 200), about]))
        picture = bundle.prepare(bundle.spec.world.examined(one.scene.view()))
        free = one.truth.valid_batch(rows.astype(np.float64))
        losses.append(log_losses(bundle.score(picture, rows), free, 1e-3).mean())
        query = PlanQuery(tuple(one.start), tuple(one.goal), number, 0.0, LIMIT_S, PATHS)
        found = bundle.plan(picture, query)
        hits.append(len(found.path) > 0 and one.collided_at(found.path) is not None)
        confidences.append(found.confidence if len(found.path) else 1.0)
    return np.array(losses), np.array(hits), np.array(confidences)


def main() -> int:
    parser = arguments(__doc__)
    commands = parser.add_subparsers(required=True)
    reporting = commands.add_parser("report")
    reporting.set_defaults(run=report)
    reporting.add_argument("--url", default="http://127.0.0.1:8000")
    reporting.add_argument("--model", help="default: the server's")
    reporting.add_argument("--site", default="cage")
    reporting.add_argument("--plans", type=int, default=240)
    reporting.add_argument("--seed", type=int, default=SEED, help="of cameras")
    reporting.add_argument("--forget", action="store_true", help="the server keeps no pictures")
    comparing = commands.add_parser("compare")
    comparing.set_defaults(run=compare)
    comparing.add_argument("--problems", type=Path, required=True, help="the folder of the test problems")
    comparing.add_argument("--cages", type=int, default=60)
    comparing.add_argument("--own", type=int, default=10, help="of each of the project's own families")
    comparing.add_argument("bundles", nargs="+", metavar="NAME=BUNDLE")
    options = parser.parse_args()
    print(machine())
    options.run(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
