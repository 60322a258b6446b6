"""Do workers buy quality? Real jobs on a Ray cluster of two workers: wall time by Tune's clocks, and quality.

    python -m benchmarks.training.workers --out build/workers --seeds 3

All jobs share data and encoder and have no validity head. ``budget`` is in generator steps of one network.
A job's time is that from the start of its first to the end of its last trial after the encoder; quality is
measured on validation scenarios. Jobs that are done are not trained again.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.lines import spread
from benchmarks.machine import ROOT
from cspace.bundle import Bundle
from cspace.files import make_output_folder
from cspace.splits import Split
from services.evaluator.evaluation.tables import markdown
from services.evaluator.measures.scenes import Stage, measure_reconstruction
from services.planner.sources.local_sampler import BundleSampler

SCENARIOS = 40


@dataclass(frozen=True)
class Arm:
    """One kind of job: its trials, all they may spend in units of ``--steps``, its settings."""

    name: str
    budget: float
    settings: tuple[str, ...]


def arms(steps: int) -> tuple[Arm, ...]:
    """Without a gate, with one, and mixtures at the same budget and at the same wall time."""

    def mixture(count: int, each: int) -> tuple[str, ...]:
        return (f"clusters.count={count}", f"local.steps={each}")

    bare = ("clusters.form=guided", "clusters.count=1", "gate.cells=0", "global.local_critic_weight=0")
    look = tuple(
        f"global.{side}_lookups={{points_per_link: {points}, side_m: 0.1}}"
        for side, points in (("generator", 12), ("critic", 8))
    )
    return (
        Arm("single, no gate", 1.0, (*bare, *look, f"global.steps={steps}")),
        Arm("1 trial behind a gate", 1.0, mixture(1, steps)),
        Arm("2 trials", 1.0, mixture(2, steps // 2)),
        Arm("4 trials, two at a time", 1.0, mixture(4, steps // 4)),
        Arm("2 trials, equal wall time", 2.0, mixture(2, steps)),
    )


def run(out: Path, name: str, settings: tuple[str, ...]) -> dict[str, object]:
    """A job's result; trained where it is not there yet."""
    kept = out / "results" / f"{name}.json"
    if not kept.is_file():
        kept.parent.mkdir(parents=True, exist_ok=True)
        sets = [part for one in (*settings, "validity.steps=0") for part in ("--set", one)]
        environment = os.environ | {
            "MLFLOW_TRACKING_URI": f"sqlite:///{out / 'mlflow.db'}",
            "CSPACE_DATA_DIR": str(out / "data"),
            "RAY_AUTH_MODE": "disabled",
            "RAY_USAGE_STATS_ENABLED": "0",
            "MLFLOW_DISABLE_TELEMETRY": "true",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": str(ROOT),
        }
        command = [sys.executable, "-m", "training.cluster_train", "--preset", "quickstart", *sets]
        done = subprocess.run(command, cwd=out, env=environment, capture_output=True, text=True, check=False)
        lines = [line for line in done.stdout.splitlines() if line.startswith("RESULT ")]
        if done.returncode or not lines:
            raise RuntimeError(f"{name}:\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}")
        kept.write_text(lines[-1].removeprefix("RESULT "))
    return json.loads(kept.read_text())


def judge(out: Path, result: dict[str, object]) -> list[float]:
    """Seconds, precision, coverage, EDr."""
    bundle = Bundle.load(out / "data" / "jobs" / str(result["run_id"]) / "bundle")
    stage = Stage(bundle.spec.world, Split.VALIDATION, 0)
    found = measure_reconstruction(stage, BundleSampler(bundle), SCENARIOS).sampler
    clocks = [clock for name, clock in result["trials"].items() if name != "vae"]
    seconds = max(end for _, end in clocks) - min(start for start, _ in clocks)
    return [seconds, *(getattr(found, name).estimate for name in ("precision", "coverage", "edr"))]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=400, help="a budget of 1, in generator steps")
    options = parser.parse_args()
    out = options.out.resolve()
    make_output_folder(out)
    first = run(out, "encoder", ("local.steps=2", "gate.steps=2"))
    (encoder,) = (out / "data" / "jobs" / str(first["run_id"])).glob("*/vae/step-*")
    rows: dict[str, list[list[float]]] = {}
    for seed in range(options.seeds):
        for arm in arms(options.steps):
            name = f"{arm.name.replace(', ', '-').replace(' ', '_')}-{options.steps}-{seed}"
            settings = (*arm.settings, f"seed={seed}", f"vae.checkpoint={encoder}")
            rows.setdefault(arm.name, []).append(judge(out, run(out, name, settings)))
            print(f"seed {seed}, {arm.name}: {np.round(rows[arm.name][-1], 3)}", flush=True)
    table = [["job", "budget", "wall time, s", "precision", "coverage", "EDr"]]
    for arm in arms(options.steps):
        columns = list(zip(*rows[arm.name], strict=True))
        cells = [spread(columns[0], 0)]
        cells += [f"{np.mean(values):.3f} ± {np.std(values):.3f}" for values in columns[1:]]
        table.append([arm.name, f"{arm.budget:g}", *cells])
    print(markdown(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
