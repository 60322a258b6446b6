"""How long the logging of an evaluation takes: metrics, tables, report and pictures of the shipped model's.

    make up
    python -m benchmarks.evaluation.logging_time --tracking-uri http://127.0.0.1:5000

The evaluation is measured once, on few scenarios, and logged again and again, each time into a run of its
own. Run it in turns with another tree (``PYTHONPATH``) to compare releases.
"""

import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.command import arguments
from cspace.bundle import Bundle
from cspace.worlds import workshop_of
from services.evaluator.evaluation.budget import QUICK, units
from services.evaluator.evaluation.execution import run_here
from services.evaluator.evaluation.gate import Bar
from services.evaluator.evaluation.recording import decide, log_evaluation
from services.evaluator.evaluation.units import Setting, assemble
from services.evaluator.measures.samplers import PackedBundle, bundle_sampler
from services.registry.tracking.mlflow_tracking import MlflowTracking

EXPERIMENT = "benchmark-logging-time"
SHIPPED = Path(__file__).parents[2] / "inference_api" / "pretrained"


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--tracking-uri", required=True)
    parser.add_argument("--times", type=int, default=9)
    options = parser.parse_args()
    bundle = Bundle.load(SHIPPED)
    setting = Setting(bundle.spec.world, 0, replace(QUICK, scenarios=6))
    shop = workshop_of(setting.world)
    work = units(setting.budget, shop.families, paths=False, there=shop.count)
    evaluation = assemble(run_here(work, setting, PackedBundle.pack(bundle)), setting)
    verdict, sampler = decide(evaluation, Bar()), bundle_sampler(bundle)
    tracking, taken_s = MlflowTracking(options.tracking_uri), []
    for number in range(options.times + 1):
        began = time.perf_counter()
        with tracking.start(EXPERIMENT, f"evaluation {number}") as run:
            log_evaluation(run, evaluation, verdict, sampler, "shipped")
        taken_s.append(time.perf_counter() - began)
    # The first one warms the server and matplotlib up.
    warm = taken_s[1:]
    print(
        f"logging an evaluation: median {statistics.median(warm):.2f} s "
        f"(min {min(warm):.2f}, max {max(warm):.2f}), {len(warm)} times, the first {taken_s[0]:.2f} s"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
