"""What samples that know start and goal gain: RRT and RRT-Connect with a path sampler over HTTP.

    python benchmarks/planning/path_samplers.py --out build/paths --problems 600 --split test

Makes the path sampler of the shipped bundle's validity head, serves it, and solves the same problems with
the same seeds by every arm: OMPL's RRT and RRT-Connect with uniform samples, OMPL's RRT and the project's own
RRT-Connect with those of the path sampler. Ratios are to the same planner with uniform samples. Iterations of
a run without success count as more than all others'. ``within 1000`` is the share solved within 1000
iterations; the times are of the whole request and of the solve alone. The novelty of a picture changes no
share here. Results lie beside each other as JSON lines, so that a stopped benchmark goes on.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

# The server is started as in the benchmarks of serving.
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "serving"))
from served import BUNDLE, machine, served

from cspace.bundle import Bundle
from cspace.image import encode_png
from cspace.problem import Family, Problem, draw_problem
from cspace.render import render
from cspace.scenario import Split
from services.evaluator.evaluation import PLANNER, planner_seed
from services.evaluator.statistics import bootstrap_interval, clopper_pearson, ratio_of_sums_interval
from services.evaluator.tables import markdown
from services.planner.ompl_planner import solve
from services.planner.sampling_client import SamplingClient
from services.planner.settings import RRT, RRT_CONNECT, SAMPLED_CONNECT
from training.path_sampler import make_path_bundle

SEED = 0
SAMPLES = 300
MOST = 20_000
WITHIN = 1000
BASE, CONNECT = "uniform", "RRT-Connect, uniform"


@dataclass(frozen=True)
class Arm:
    """One way to solve.

    Args:
        range_rad: of the planner.
        uniform_share: None for OMPL's own uniform sampling.
        min_confidence: what is asked of the sampler.
        planner: by its name in the settings.
        base: the arm that it is compared with.
    """

    range_rad: float = 1.0
    uniform_share: float | None = None
    min_confidence: float = 0.0
    planner: str = RRT
    base: str = BASE


ARMS = {
    BASE: Arm(),
    "uniform, range 0.5": Arm(range_rad=0.5),
    "path, 70 %": Arm(uniform_share=0.3),
    "path, 70 %, filtered": Arm(uniform_share=0.3, min_confidence=0.5),
    "path, 100 %": Arm(uniform_share=0.0),
    CONNECT: Arm(planner=RRT_CONNECT, base=CONNECT),
    "RRT-Connect, path, 70 %": Arm(uniform_share=0.3, planner=SAMPLED_CONNECT, base=CONNECT),
    "RRT-Connect, path, 100 %": Arm(uniform_share=0.0, planner=SAMPLED_CONNECT, base=CONNECT),
}


@dataclass(frozen=True)
class Run:
    """What came of one arm on one problem; iterations of a run without success are ``2 MOST``."""

    iterations: int
    length_rad: float | None
    request_s: float
    solve_s: float


def run(problem: Problem, arm: Arm, client: SamplingClient, seed: int) -> Run:
    samples, began = None, time.perf_counter()
    if arm.uniform_share is not None:
        samples = client.sample(
            encode_png(render(problem.scenario)),
            SAMPLES,
            seed=seed,
            start=problem.start.tolist(),
            goal=problem.goal.tolist(),
            min_confidence=arm.min_confidence,
        ).samples
    request_s = time.perf_counter() - began
    settings = replace(PLANNER, planner=arm.planner, range_rad=arm.range_rad, seed=seed, max_iterations=MOST)
    found = solve(problem, settings, samples, arm.uniform_share or 0.0)
    iterations = found.iterations if found.solved else 2 * MOST
    return Run(iterations, float(found.length_rad) if found.solved else None, request_s, found.solve_time_s)


def measured(family: Family, split: Split, port: int, index: int) -> dict[str, object]:
    problem, seed = draw_problem(family, split, SEED, index), planner_seed(SEED, index, 0)
    with SamplingClient(f"http://127.0.0.1:{port}") as client:
        found = {name: asdict(run(problem, arm, client, seed)) for name, arm in ARMS.items()}
    return {"family": family.value, "split": split.value, "index": index, "arms": found}


def gather(out: Path, family: Family, split: Split, count: int, port: int, processes: int) -> list[dict]:
    kept = out / f"{split.value}-{family.value}.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.is_file() else []
    missing = sorted(set(range(count)) - {row["index"] for row in rows})
    one = partial(measured, family, split, port)
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool, kept.open("a") as lines:
        for done in as_completed([pool.submit(one, index) for index in missing]):
            rows.append(done.result())
            lines.write(json.dumps(rows[-1]) + "\n")
            lines.flush()
            if len(rows) % 25 == 0:
                print(f"{family.value}: {len(rows)}/{count}", file=sys.stderr, flush=True)
    return sorted((row for row in rows if row["index"] < count), key=lambda row: row["index"])


def ratio(
    values: np.ndarray, base: np.ndarray, of: Callable[[np.ndarray], np.ndarray], rng: np.random.Generator
) -> str:
    """A statistic of an arm over that of the baseline, with its interval over problems."""

    def statistic(table: np.ndarray) -> np.ndarray:
        return of(table[..., 0]) / of(table[..., 1])

    return f"{bootstrap_interval(np.stack([values, base], axis=-1), statistic, rng):.2f}"


def table(rows: list[dict]) -> list[list[str]]:
    rng = np.random.default_rng(SEED)
    head = [
        "arm",
        "median",
        "p90",
        "of uniform's median",
        "of its p90",
        f"within {WITHIN}",
        "length of uniform's",
    ]
    lines = [[*head, "request, ms", "solve, ms"]]
    for name, arm in ARMS.items():
        base = np.array([row["arms"][arm.base]["iterations"] for row in rows], dtype=float)
        runs = [row["arms"][name] for row in rows]
        values = np.array([one["iterations"] for one in runs], dtype=float)
        both = [
            (one["length_rad"], row["arms"][arm.base]["length_rad"])
            for one, row in zip(runs, rows, strict=True)
            if one["length_rad"] and row["arms"][arm.base]["length_rad"]
        ]
        solved = int(np.sum(values <= WITHIN))
        lines.append(
            [
                name,
                f"{np.median(values):.0f}",
                f"{np.quantile(values, 0.9):.0f}",
                ratio(values, base, lambda part: np.median(part, axis=-1), rng),
                ratio(values, base, lambda part: np.quantile(part, 0.9, axis=-1), rng),
                f"{clopper_pearson(solved, len(values)):.4f}",
                f"{ratio_of_sums_interval(*map(np.array, zip(*both, strict=True)), rng):.2f}",
                *(f"{1e3 * np.median([one[key] for one in runs]):.1f}" for key in ("request_s", "solve_s")),
            ]
        )
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--problems", type=int, default=600, help="of each family")
    parser.add_argument("--split", choices=["validation", "test"], default="validation")
    parser.add_argument("--families", type=Family, nargs="+", default=[Family.NARROW, Family.UNIFORM])
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    folder = options.out / "path-bundle"
    bundle = Bundle.load(folder) if folder.is_dir() else make_path_bundle(Bundle.load(BUNDLE), folder)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    print(f"{bundle.digest[:12]}, {options.problems} {options.split} problems a family; {machine()}")
    with served({"CSPACE_PRETRAINED_MODEL": str(folder.resolve())}) as api:
        for family in options.families:
            rows = gather(
                options.out, family, Split(options.split), options.problems, api.port, options.processes
            )
            print(f"\n{family.value}\n\n{markdown(table(rows))}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
