"""Protocols ``families`` and ``paper``: a problem solved by all arms of a unit, with the same seed."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cache, lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from cspace.query import SampleQuery
from cspace.simulator import Problem, Split
from cspace.world import World
from cspace.worlds import checker_of, simulator_of
from services.evaluator.benchmark.arms import Arm, Setting, Unit
from services.evaluator.benchmark.runs import Row
from services.evaluator.benchmark.sources import SourceSpec, ask, opened
from services.planner.ompl_planner import solve
from services.planner.result import CostPoint, PlanResult, Reason, check_path
from services.planner.rrt_connect import order_along
from services.planner.samples import SampleBatch, SourceTiming

EDGES, REPEATS = 1000, 5


def sample_units(
    setting: Setting, problems: Mapping[str, int], runs: int, arms: Sequence[Arm]
) -> Iterator[Unit]:
    """Every run of every problem, of so many in each family; those without a path have no optimising arms."""
    for family, count in problems.items():
        own = [arm for arm in arms if arm.stop_at_first or family in setting.families.solvable]
        for index, run in product(range(count), range(runs)):
            yield Unit(family, index, tuple((arm, run) for arm in own))


class SampleWorker:
    """Runs units in one process; the samplers stay open as long as it exists.

    Raises:
        SamplerError: a sampler does not answer.
    """

    def __init__(self, setting: Setting, specs: Sequence[SourceSpec]) -> None:
        self._setting, self.specs = setting, {spec.name: spec for spec in specs}
        self._open = ExitStack()
        self.sources = self._open.enter_context(opened(specs, setting.world))

    def run(self, unit: Unit) -> list[Row]:
        """The rows of a unit; nothing in them depends on another unit.

        Raises:
            SamplerError: a sampler does not answer: a run without its samples would measure another arm.
        """
        setting = self._setting
        problem = known_problem(setting.world, unit.family, setting.split, setting.seed, unit.index)
        check_s = _state_check_s(problem, setting.range_rad, setting.resolution_rad)
        first = setting.planner(None, unit.index, unit.todo[0][1]).seed

        # Arms with the same request share a batch, and each counts its time.
        @cache
        def request_samples(sampler: str, query: SampleQuery) -> SampleBatch:
            return ask(self.sources[sampler], self.specs[sampler], problem, query)

        rows = []
        # Each unit has its own order, so that no arm is always the one that finds the caches warm.
        for position in np.random.default_rng([first, 1]).permutation(len(unit.todo)):
            arm, run = unit.todo[position]
            settings = setting.planner(arm, unit.index, run)
            batch = None if arm.sampler is None else request_samples(arm.sampler, arm.query(settings.seed))
            began = time.perf_counter()
            samples = None if batch is None else filtered_samples(arm, batch, problem)
            order_s = time.perf_counter() - began
            result = solve(problem, settings, samples, 1.0 - arm.learned_share)
            # Putting the samples in order is the planner's work.
            result = replace(result, solve_time_s=result.solve_time_s + order_s)
            # The path is checked here, whatever the planner reports.
            reason = result.reason
            if result.solved:
                reason = check_path(problem, result.path, settings.resolution_rad)
            about = {
                "protocol": setting.protocol.value,
                "family": unit.family,
                "problem": unit.index,
                "run": run,
                "seed": settings.seed,
                "iteration_limit": settings.max_iterations,
                "time_limit_s": settings.time_limit_s,
                "bottleneck_rad": problem.bottleneck_rad if math.isfinite(problem.bottleneck_rad) else None,
            }
            rows.append(about | _of_arm(arm, batch) | _of_result(result, reason))
            rows[-1] |= _times(batch, result, check_s)
        return rows


def _of_arm(arm: Arm, batch: SampleBatch | None) -> Row:
    names = ("planner", "sampler", "learned_share", "min_confidence", "range_rad", "stop_at_first")
    return {name: getattr(arm, name) for name in names} | {
        "arm": arm.name,
        "group": arm.group.value,
        "epsilon_sigma": list(arm.epsilon_sigma),
        "samples_asked": arm.samples,
        "samples_got": 0 if batch is None else len(batch.samples),
        "novelty": None if batch is None else batch.novelty,
    }


def _of_result(result: PlanResult, reason: Reason | str) -> Row:
    solved = reason == Reason.SOLVED
    costs = result.costs if solved else ()
    end = CostPoint(result.iterations, result.edge_checks, result.solve_time_s, float(result.length_rad))
    names = ("iterations", "edge_checks", "state_checks", "learned_drawn", "uniform_drawn")
    row = {name: getattr(result, name) for name in names}
    row |= {"solved": solved, "reason": str(reason), "length_rad": end.length_rad if solved else None}
    for name in ("iterations", "edge_checks", "time_s", "length_rad"):
        column = name.removeprefix("time_")
        row[f"first_{column}"] = getattr([*costs, end][0], name) if solved else None
        row[f"cost_{column}"] = [getattr(point, name) for point in costs]
    return row


def _times(batch: SampleBatch | None, result: PlanResult, state_check_s: float) -> Row:
    request_s, solve_s = 0.0 if batch is None else batch.round_trip_s, result.solve_time_s
    check_s = result.state_checks * state_check_s
    # All time of a source that reports none is transport.
    timing = SourceTiming(0.0, 0.0, 0.0, 0.0) if batch is None or batch.timing is None else batch.timing
    return {
        "solve_s": solve_s,
        "state_check_s": state_check_s,
        "check_s": check_s,
        "plan_s": solve_s - check_s,
        "request_s": request_s,
        "decode_s": timing.decode_s,
        "encode_s": timing.encode_s,
        "generate_s": timing.generate_s,
        "server_s": timing.total_s,
        "transport_s": request_s - timing.total_s,
        "total_s": request_s + solve_s,
    }


def filtered_samples(arm: Arm, batch: SampleBatch, problem: Problem) -> NDArray[np.float32]:
    """The samples (n, d) rad in the order in which the planner draws them."""
    if arm.ordered:
        return batch.samples[order_along(batch.samples, problem.start, problem.goal, problem.space)]
    if arm.in_order or len(arm.epsilon_sigma) == 1:
        return batch.samples
    return np.random.default_rng([batch.seed, 3]).permutation(batch.samples)


@lru_cache(maxsize=4)
def known_problem(world: World, family: str, split: Split, seed: int, index: int) -> Problem:
    """A problem, kept for the next run on it: a narrow one takes half a second to find."""
    return simulator_of(world).problem(family, split, seed, index)


def state_check_s(problem: Problem, range_rad: float, resolution_rad: float) -> float:
    """Seconds for one state check, the fastest of five compiled loops over 1000 edges.

    An edge leads from a free configuration towards a uniform one, as far as the planner's range, as in a
    growing tree. The step from OMPL to Python does not count: it is the planner's.

    Args:
        problem: whose scenario.
        range_rad: longest edge, in OMPL's metric (the sum over the joints), rad.
        resolution_rad: largest distance between checked states in any joint, rad.
    """
    checker, space, rng = checker_of(problem.scenario), problem.space, np.random.default_rng(0)
    sampled = space.sample_uniform(rng, EDGES)
    starts = np.concatenate([np.stack([problem.start, problem.goal]), sampled[checker.valid_batch(sampled)]])
    starts = starts[rng.integers(0, len(starts), EDGES)]
    gaps = space.difference(starts, space.sample_uniform(rng, EDGES))
    lengths = np.abs(gaps).sum(axis=1, keepdims=True)
    ends = space.wrap(starts + gaps * np.minimum(1.0, range_rad / np.maximum(lengths, 1e-12)))
    edge_test = checker.edge_test(resolution_rad)
    looked = sum(int(edge_test(start, end)[1]) for start, end in zip(starts, ends, strict=True))
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        checker.edge_batch(starts, ends, resolution_rad)
        taken.append(time.perf_counter() - began)
    return min(taken) / looked


_state_check_s = lru_cache(maxsize=4)(state_check_s)
