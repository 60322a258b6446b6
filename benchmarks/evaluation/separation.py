"""What GS and GS-C tell apart: real, noisy and uniform samples; a divided free space from a whole one.

    OMP_NUM_THREADS=1 python -m benchmarks.evaluation.separation --out results/separation

Two questions, both on two joints, every score between clouds drawn anew for each repeat:

1. In scenarios: real samples against real ones, against real ones with 0.1 rad of normal noise a
   joint, against uniform ones.
2. A free space that an obstacle divides into two parts against one that is not divided. ``arm``: one disc
   of 0.3 or 0.5 m, which only the second link can reach, against the same disc where it blocks the first
   link, as in the paper's figure. ``room``: a square of free space with obstacles all round, against the
   same with a wall through its middle; here theory says what should be seen: no loop in either free space,
   one in the complement of the whole room, two in that of the divided one. ``rim``: the control, the room
   with the wall along its side, as much free space and not divided. ``door``: the divided room against one
   whose wall has a door of so many rad in its middle, which is whole and hardly another shape.

Intervals are 95 % by bootstrap over repeats. A range is from the smallest to the largest single score: what
one evaluation may see. Writes the rows as JSON and tables as Markdown; separation_figure.py draws them.
"""

import itertools
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.files import make_output_folder
from cspace.splits import Split
from cspace.worlds.planar.arm import TWO_LINK
from cspace.worlds.planar.planning.collision import CollisionChecker
from cspace.worlds.planar.scene import Disc, Scenario
from cspace.worlds.planar.seeing.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.evaluation.tables import markdown
from services.evaluator.measures.scenes import Scene, Stage
from services.evaluator.measures.topology.complement import POINTS_PER_CELL, sample_complement
from services.evaluator.measures.topology.complement_score import (
    TurnedTimes,
    complement_score,
    turned_living_times,
)
from services.evaluator.measures.topology.geometry_score import (
    POINTS,
    RelativeLivingTimes,
    geometry_score,
    mean_living_times,
)
from services.evaluator.statistics import mean_interval

SPACE = TWO_LINK.space
NOISE_RAD = 0.1
SEED = 0
DOORS_RAD = (0.5, 0.75, 1.0, 1.5, 3.0)


@dataclass(frozen=True)
class Measured:
    """All that the scores need of one cloud."""

    plain: RelativeLivingTimes
    free: TurnedTimes
    complement: TurnedTimes


def measured(cloud, rng, draws: int) -> Measured:
    complement = sample_complement(cloud, SPACE, rng, len(cloud))
    return Measured(
        mean_living_times(cloud, rng, draws=draws),
        turned_living_times(cloud, SPACE, rng, draws=draws),
        turned_living_times(complement, SPACE, rng, draws=draws),
    )


def scores(first: Measured, second: Measured) -> dict[str, float]:
    return {
        "gs": geometry_score(first.plain, second.plain),
        "gsc": complement_score(first.free, second.free, first.complement, second.complement),
    }


def scenario_repeat(scene: Scene, rng, samples: int, draws: int):
    real, again, base = (scene.free(samples, rng) for _ in range(3))
    noisy = SPACE.wrap(base + rng.normal(0.0, NOISE_RAD, base.shape))
    reference = measured(real, rng, draws)
    others = {"real": again, "noise": noisy, "uniform": SPACE.sample_uniform(rng, samples)}
    return {name: scores(reference, measured(cloud, rng, draws)) for name, cloud in others.items()}


def arm_free(radius_m: float, distance_m: float):
    """Free configurations with one disc so far from the base; the first link reaches 2.1 m."""
    checker = CollisionChecker(Scenario(TWO_LINK, (Disc(distance_m, 0.0, radius_m),)))

    def draw(samples, rng):
        proposals = SPACE.sample_uniform(rng, 2 * samples)
        return proposals[checker.valid_batch(proposals)][:samples]

    return draw


def room_free(samples_in_all: int, wall: str, door_rad: float = 0.0):
    """Free configurations of the room; frame and wall are as wide as two cells of the complement's grid."""
    width = 2.0 * 2.0 * np.pi / int((samples_in_all / POINTS_PER_CELL) ** 0.5)
    half = np.pi - width

    def draw(samples, rng):
        inside = rng.uniform(-half, half, (4 * samples, 2))
        blocked = {
            "none": np.zeros(len(inside), dtype=bool),
            "middle": (np.abs(inside[:, 0]) < width / 2.0) & (np.abs(inside[:, 1]) >= door_rad / 2.0),
            "side": inside[:, 0] < -half + width,
        }
        return inside[~blocked[wall]][:samples]

    return draw


def division_repeat(whole, divided, control, rng, samples: int, draws: int):
    one, two = (measured(whole(samples, rng), rng, draws) for _ in range(2))
    apart, again = (measured(divided(samples, rng), rng, draws) for _ in range(2))
    found = {
        "whole, whole": scores(one, two),
        "divided, divided": scores(apart, again),
        "whole, divided": scores(one, apart),
    }
    if control is not None:
        found["whole, rim"] = scores(one, measured(control(samples, rng), rng, draws))
    return found


def blocked_share(scene: Scene) -> float:
    return 1.0 - float(np.mean(scene.checker.valid_batch(SPACE.sample_uniform(scene.rng(0), 20_000))))


def scenes_of(split: Split, count: int, least_blocked: float):
    """The first scenarios of the split in which obstacles take at least that share of the joint space."""
    stage = Stage(PlanarWorld(TWO_LINK, Camera()), split, SEED)
    scenes = (Scene(stage, index) for index in itertools.count())
    return itertools.islice((scene for scene in scenes if blocked_share(scene) >= least_blocked), count)


def cases(samples: int, split: Split, scenarios: int, least_blocked: float):
    """Name and what one repeat does, for every group of rows."""
    divisions = {
        f"arm, {radius} m": (arm_free(radius, 2.3 + radius), arm_free(radius, 1.5), None)
        for radius in (0.3, 0.5)
    } | {"room": tuple(room_free(samples, wall) for wall in ("none", "middle", "side"))}
    divisions |= {
        f"door, {door} rad": (room_free(samples, "middle", door), room_free(samples, "middle"), None)
        for door in DOORS_RAD
    }
    for name, spaces in divisions.items():
        yield name, lambda *rest, spaces=spaces: division_repeat(*spaces, *rest)
    for scene in scenes_of(split, scenarios, least_blocked):
        name = f"scenario {scene.index}, {blocked_share(scene):.0%} blocked"
        yield name, lambda *rest, scene=scene: scenario_repeat(scene, *rest)


def summary(rows: list[dict]) -> list[dict]:
    """Interval and range of every score of every pair in every group."""
    groups: dict[tuple[str, str, str], list[float]] = {}
    by_repeat: dict[tuple[str, str, int], list[float]] = {}
    for row in rows:
        for pair, values in row["scores"].items():
            for score, value in values.items():
                groups.setdefault((row["case"], pair, score), []).append(value)
                if row["case"].startswith("scenario"):
                    by_repeat.setdefault((pair, score, row["repeat"]), []).append(value)
    # Over the scenarios of this run; the interval is of the chance in samples and landmarks alone.
    for (pair, score, _), values in by_repeat.items():
        groups.setdefault(("mean of scenarios", pair, score), []).append(float(np.mean(values)))
    return [
        {"case": case, "pair": pair, "score": score, "smallest": min(values), "largest": max(values)}
        | mean_interval(values, np.random.default_rng(SEED)).to_dict()
        for (case, pair, score), values in groups.items()
    ]


def table(summaries: list[dict]) -> str:
    rows = [["case", "pair", "score", "x 1e4, 95 % interval", "range", "repeats"]]
    for one in sorted(summaries, key=lambda one: (one["case"], one["score"])):
        value, low, high, least, most = (
            f"{one[key] * 1e4:.3g}" for key in ("estimate", "low", "high", "smallest", "largest")
        )
        cells = [one["case"], one["pair"], one["score"], f"{value} [{low}, {high}]", f"{least} to {most}"]
        rows.append([*cells, str(one["count"])])
    return markdown(rows) + "\n"


def write(out: Path, setting: dict, rows: list[dict]) -> None:
    summaries = summary(rows)
    content = {"machine": machine(), "setting": setting, "summary": summaries, "rows": rows}
    make_output_folder(out)
    (out / "separation.json").write_text(json.dumps(content, indent=1))
    (out / "separation.md").write_text(table(summaries))


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--samples", type=int, default=POINTS)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--split", choices=["validation", "test"], default="validation")
    parser.add_argument("--scenarios", type=int, default=4)
    parser.add_argument("--least-blocked", type=float, default=0.0, help="share of the joint space")
    parser.add_argument("--repeats", type=int, default=12)
    parser.add_argument("--cases", nargs="+", default=["arm", "room", "door", "scenario"])
    options = parser.parse_args()
    setting = {name: str(value) for name, value in vars(options).items() if name != "out"}
    rows: list[dict] = []
    every = cases(options.samples, Split(options.split), options.scenarios, options.least_blocked)
    groups = [(name, once) for name, once in every if name.startswith(tuple(options.cases))]
    for repeat in range(options.repeats):
        for number, (name, once) in enumerate(groups):
            began, rng = time.perf_counter(), np.random.default_rng([SEED, number, repeat])
            found = once(rng, options.samples, options.draws)
            rows.append({"case": name, "repeat": repeat, "scores": found})
            print(f"{repeat + 1} {name}: {time.perf_counter() - began:.1f} s", file=sys.stderr, flush=True)
        write(options.out, setting | {"done": str(repeat + 1)}, rows)
    print((options.out / "separation.md").read_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
