"""Plans from one, two and three depth pictures: how often they collide, and how far their confidence holds.

    python -m benchmarks.spatial.plans BUNDLE --out FOLDER [--problems 3] [--split test --folder PROBLEMS]

Runs `python -m services.evaluator planning --protocol plans` on MotionBenchMaker's problems for the bundle
and for the rule that takes unseen space as free, or continues the runs of FOLDER. Printed by number of
pictures: solved problems; the share of plans that collide (95 % bootstrap); the calibration error of a plan's
confidence with what exact confidences would give on so few plans; what `max_risk` releases and how much of it
collides; and the time of a plan. FOLDER holds all runs and the benchmark's report.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import bootstrap

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.planning.cost import calibration_error
from cspace.worlds import named_world, partly_seen
from services.evaluator.benchmark.__main__ import main as planning
from services.evaluator.benchmark.job import NO_PROBLEM

MODEL, FREE = "model", "unseen is free"
SOURCE = "MotionBenchMaker"
DRAWS = 2000


def share(flags: pd.Series) -> str:
    """A share with its interval over problems."""
    values = flags.to_numpy(dtype=float)
    if len(values) < 2 or values.min() == values.max():
        return f"{values.mean():.3f} ({len(values)})" if len(values) else "-"
    found = bootstrap((values,), np.mean, method="percentile", rng=np.random.default_rng(0))
    low, high = found.confidence_interval
    return f"{values.mean():.3f} [{low:.3f}, {high:.3f}] ({len(values)})"


def calibration(plans: pd.DataFrame, rng: np.random.Generator) -> str:
    """The error, its interval, and its mean if every confidence were exact."""
    confidence, free = plans["confidence"].to_numpy(), (plans["clearance_m"] > 0.0).to_numpy()
    if not len(plans):
        return "-"
    picks = rng.integers(0, len(plans), (DRAWS, len(plans)))
    low, high = np.quantile(
        [calibration_error(confidence[pick], free[pick]) for pick in picks], [0.025, 0.975]
    )
    exact = [calibration_error(confidence, rng.random(len(plans)) < confidence) for _ in range(DRAWS)]
    return f"{calibration_error(confidence, free):.3f} [{low:.3f}, {high:.3f}], exact {np.mean(exact):.3f}"


def report(runs: pd.DataFrame, max_risk: float) -> pd.DataFrame:
    """One row for each number of pictures."""
    runs, rng, rows = runs[runs["status"] != NO_PROBLEM], np.random.default_rng(0), []
    for pictures, own in runs[runs["pictures"] > 0].groupby("pictures"):
        model, rule = (own[own["variant"] == name] for name in (MODEL, FREE))
        plans, others = model[model["solved"]], rule[rule["solved"]]
        released = plans[plans["confidence"] >= 1.0 - max_risk]
        times_ms = 1e3 * model["request_s"]
        rows.append(
            {
                "pictures": pictures,
                "problems": len(model),
                "solved": f"{model['solved'].mean():.3f}",
                "collide": share(plans["clearance_m"] <= 0.0),
                "by meshes": share(~plans["meshes_free"].dropna().astype(bool)),
                FREE: share(others["clearance_m"] <= 0.0),
                "calibration error": calibration(plans, rng),
                f"released at max_risk {max_risk:g}": f"{len(released) / len(model):.3f}",
                "of these collide": share(released["clearance_m"] <= 0.0),
                "ms, median (p95)": f"{times_ms.median():.0f} ({times_ms.quantile(0.95):.0f})",
            }
        )
    return pd.DataFrame(rows).set_index("pictures").T.rename_axis("pictures")


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs")
    parser.add_argument(
        "--robot", default="panda", help="an example or a robot's file (default: %(default)s)"
    )
    parser.add_argument("--split", choices=("validation", "test"), default="validation")
    parser.add_argument("--folder", type=Path, help="of the test problems")
    parser.add_argument("--problems", type=int, help="of each family (default: all)")
    parser.add_argument("--pictures", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--max-risk", type=float, default=0.05, help="default: %(default)s")
    parser.add_argument("--processes", type=int, default=1, help="one gives the truest times")
    options = parser.parse_args()
    given = [
        "--protocol", "plans", "--out", str(options.out), "--robot", options.robot, "--split", options.split,
        "--bundle", f"{MODEL}={options.bundle}", "--variants", MODEL, FREE, "--no-mlflow",
        "--processes", str(options.processes), "--pictures", *map(str, options.pictures),
    ]  # fmt: skip
    for family in partly_seen(named_world(options.robot)).sources[SOURCE]:
        given += ["--family", family]
    for name in ("problems", "folder"):
        if (value := getattr(options, name)) is not None:
            given += ["--problems-folder" if name == "folder" else "--problems", str(value)]
    if code := planning(given, {}):
        return code
    runs = pd.read_parquet(options.out / "runs.parquet")
    print(f"\n{machine()}\n\n{report(runs, options.max_risk).to_markdown(disable_numparse=True)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
