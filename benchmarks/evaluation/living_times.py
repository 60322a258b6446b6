"""How long living times take: draws of 64 landmarks from 5000 points, in one process and in two.

    OMP_NUM_THREADS=1 python -m benchmarks.evaluation.living_times

The points are free configurations of two joints round a square obstacle. The peer is what the original
implementation does: every witness hands GUDHI the list of all its landmarks. Peer and product take turns in
this one process, then the product alone is timed on ever more processes, which are started and warmed up
before; all must give the same numbers. The profile tells where the time of a single draw goes.
"""

import statistics
import sys
import time
from contextlib import nullcontext

import gudhi
import numpy as np
from scipy.spatial.distance import cdist

from benchmarks.command import arguments
from benchmarks.lines import spread
from benchmarks.machine import machine
from services.evaluator.measures.topology.geometry_score import (
    I_MAX,
    LANDMARKS,
    default_gamma,
    living_times,
    mean_living_times,
    relative_living_times,
)
from services.evaluator.measures.topology.witness import witness_complex
from services.evaluator.processes import ProcessMapper

SEED = 0


def cloud(count: int):
    points = np.random.default_rng(SEED).uniform(-np.pi, np.pi, (4 * count, 2))
    return points[np.abs(points).max(axis=1) > 1.5][:count]


def peer(points, landmark_indices, gamma):
    """Full tables of all landmarks, sorted, as Python lists, into GUDHI's own witness complex."""
    distances = cdist(points, points[landmark_indices])
    alpha_max = float(distances.max()) * gamma
    order = np.argsort(distances, axis=1)
    table = [[(j, row[j]) for j in places] for places, row in zip(order, distances, strict=True)]
    complex_ = gudhi.WitnessComplex(table)
    tree = complex_.create_simplex_tree(max_alpha_square=alpha_max, limit_dimension=2)
    tree.compute_persistence(homology_coeff_field=2)
    return living_times(tree.persistence_intervals_in_dimension(1), alpha_max, I_MAX)


def timed(function, *arguments, **options):
    began = time.perf_counter()
    result = function(*arguments, **options)
    return result, time.perf_counter() - began


def compare(points, gamma: float, draws: int) -> None:
    rng = np.random.default_rng(SEED)
    picks = [rng.choice(len(points), LANDMARKS, replace=False) for _ in range(draws + 1)]
    ours_s, peer_s, largest = [], [], 0.0
    for number, pick in enumerate(picks):
        pair = [(relative_living_times, ours_s), (peer, peer_s)]
        results = []
        for function, times in pair if number % 2 else pair[::-1]:
            result, seconds = timed(function, points, pick, gamma)
            results.append(result.values)
            if number:
                times.append(seconds)
        largest = max(largest, float(np.abs(results[0] - results[1]).max()))
    ratio = statistics.median(theirs / own for theirs, own in zip(peer_s, ours_s, strict=True))
    print(f"one draw, peer:    {spread((1e3 * one for one in peer_s), 2)} ms")
    print(f"one draw, product: {spread((1e3 * one for one in ours_s), 2)} ms")
    print(f"peer over product: median {ratio:.0f}; largest difference in a living time {largest:.1e}")


def profile(points, gamma: float, draws: int) -> None:
    rng = np.random.default_rng(SEED)
    parts = {"distances": [], "complex": [], "persistence": [], "living times": []}
    for _ in range(draws):
        pick = rng.choice(len(points), LANDMARKS, replace=False)
        distances, seconds = timed(cdist, points, points[pick])
        parts["distances"].append(seconds)
        alpha_max = float(distances.max()) * gamma
        built, seconds = timed(witness_complex, distances, alpha_max)
        parts["complex"].append(seconds)
        intervals, seconds = timed(built.loop_intervals)
        parts["persistence"].append(seconds)
        parts["living times"].append(timed(living_times, intervals, alpha_max)[1])
    print("profile of one draw, medians: ", end="")
    print(", ".join(f"{name} {statistics.median(times) * 1e3:.2f} ms" for name, times in parts.items()))


def whole(points, draws: int, repeats: int, processes: int):
    """``draws`` draws in so many processes, which have been started and warmed up; one is the plain loop."""
    began = time.perf_counter()
    with nullcontext(map) if processes == 1 else ProcessMapper(processes) as mapper:

        def once(count):
            return mean_living_times(points, np.random.default_rng(SEED), draws=count, mapper=mapper)

        once(8 * processes)
        start_s = time.perf_counter() - began
        times = [timed(once, draws) for _ in range(repeats)]
    seconds = [second for _, second in times]
    print(
        f"{draws} draws, processes {processes}: {spread(seconds, 2)} s; warm after {start_s:.2f} s",
        flush=True,
    )
    return [result for result, _ in times]


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--peer-draws", type=int, default=10)
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    options = parser.parse_args()
    print(", ".join(f"{name} {value}" for name, value in machine().items()))
    points = cloud(options.points)
    gamma = default_gamma(options.points)
    compare(points, gamma, options.peer_draws)
    profile(points, gamma, 20 * options.peer_draws)
    results = [
        result
        for processes in options.processes
        for result in whole(points, options.draws, options.repeats, processes)
    ]
    same = all(
        np.array_equal(result.values, results[0].values) and result.remainder == results[0].remainder
        for result in results
    )
    print(f"all numbers equal to the last bit: {'yes' if same else 'NO'}")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
