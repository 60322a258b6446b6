"""What samples of the free space gain or cost in planning, with and without the validity head's filter.

    python -m benchmarks.planning.free_space_samples --problems 300

Uniform samples, a bundle's samples, and those of them that pass its head solve the same validation problems
with the same seeds. One process; about a second a narrow problem, most of it spent on finding the problem.
"""

import sys
from pathlib import Path

import numpy as np

from benchmarks.command import arguments
from benchmarks.machine import ROOT
from cspace.bundle import Bundle
from cspace.splits import Split
from cspace.worlds.planar.planning.problems import Family, draw_problem
from services.evaluator.evaluation.tables import aligned, planning_table
from services.evaluator.evaluation.units import planner_of, planner_seed
from services.evaluator.measures.planning import plan_trial
from services.evaluator.measures.planning_summary import summarise_family
from services.evaluator.measures.samplers import bundle_sampler

SEED = 0


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--bundle", type=Path, default=ROOT / "inference_api" / "pretrained")
    parser.add_argument("--family", type=Family, choices=list(Family), default=Family.NARROW)
    parser.add_argument("--problems", type=int, default=300)
    options = parser.parse_args()
    sampler = bundle_sampler(Bundle.load(options.bundle))
    world, trials = sampler.bundle.spec.world, []
    for index in range(options.problems):
        problem = draw_problem(options.family, Split.VALIDATION, SEED, index, world.body)
        trials.append(plan_trial(problem, index, planner_seed(SEED, index, 0), sampler, planner_of(world)))
        if (index + 1) % 25 == 0:
            print(f"{index + 1}/{options.problems}", file=sys.stderr, flush=True)
    print(aligned(planning_table([summarise_family(options.family, trials, np.random.default_rng(SEED))])))
    if all(trial.confident is not None for trial in trials):
        pairs = [(trial.learned.success, trial.confident.success) for trial in trials]
        learned, confident = pairs.count((True, False)), pairs.count((False, True))
        print(f"solved by learned alone: {learned}, by confident alone: {confident}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
