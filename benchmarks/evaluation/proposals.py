"""What uniform proposals beside the generator's samples buy and cost, once the head has filtered both.

    python -m benchmarks.evaluation.proposals --bundle inference_api/pretrained --scenarios 60

A share of what the head is shown is uniform; a share of 1 is the head alone. What passes is kept until there
are 500, on validation scenarios: at the threshold that ``--threshold`` names or the bundle has, and at the
lowest from there on by which it is as precise as the generator alone. Costs are those of this machine.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.bundle import Bundle
from services.evaluator.evaluation.tables import markdown
from services.evaluator.statistics import mean_interval, ratio_of_sums_interval
from training.clusters.proposals import KEPT, SHARES, Outcome, judged, proposal_costs, proposal_pools
from training.clusters.threshold import CANDIDATES


def row(found: Outcome, uniform: np.ndarray, share: float, threshold: float) -> list[str]:
    rng = np.random.default_rng(0)
    quality = [mean_interval(values, rng) for values in (found.precision, found.coverage)]
    ratio = ratio_of_sums_interval(found.energy, uniform, rng)
    cells = [f"{quality[0]:.4f}", f"{quality[1]:.3f}", f"{ratio:.3f}", f"{found.passing.mean():.3f}"]
    missing = f"{found.missing.mean():.4f}"
    return [f"{share:g}", f"{threshold:g}", *cells, missing, f"{1e6 * found.cost_s:.2f}"]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--bundle", type=Path, required=True)
    parser.add_argument("--scenarios", type=int, default=60)
    parser.add_argument("--threshold", type=float, help="instead of the bundle's")
    options = parser.parse_args()
    bundle = Bundle.load(options.bundle)
    pools = proposal_pools(bundle, bundle.spec.world, options.scenarios)
    costs = proposal_costs(bundle, pools[0].scene)
    least = bundle.spec.confidence_threshold if options.threshold is None else options.threshold
    thresholds = [least, *(one for one in CANDIDATES if one > least)]
    uniform = np.array([pool.scene.quality(pool.uniform[:KEPT], pool.held_out).energy for pool in pools])
    alone = judged(pools, costs, 0.0, least)
    table = [
        ["uniform share", "threshold", "precision", "coverage", "EDr", "accepted", "missing", "us a sample"]
    ]
    for share in SHARES:
        as_precise = next(
            (one for one in thresholds if judged(pools, costs, share, one).as_precise_as(alone)), None
        )
        told_at = sorted({least, as_precise or least})
        table += [row(judged(pools, costs, share, one), uniform, share, one) for one in told_at]
    told = {"generated": costs.learned_s, "uniform": costs.uniform_s, "scored": costs.head_s}
    each = ", ".join(f"{name} {1e6 * value:.2f}" for name, value in told.items())
    print(f"{machine()}\n\n{markdown(table)}\n\nus a configuration: {each}; a turn {1e6 * costs.turn_s:.0f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
