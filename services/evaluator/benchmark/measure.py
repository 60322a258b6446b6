"""One problem solved by all arms of a unit, with paired seeds, one after the other in this process."""

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from cspace.problem import Problem
from cspace.query import SampleQuery
from cspace.splits import Split
from cspace.workshop import Checker
from cspace.world import World
from cspace.worlds import checker_of, workshop_of
from services.evaluator.benchmark.arms import Arm, Setting, Unit
from services.evaluator.benchmark.sources import SourceSpec, ask, mixed
from services.evaluator.benchmark.store import Run, finite
from services.evaluator.evaluation.units import planner_seed
from services.planner.plan_result import CostPoint, Reason
from services.planner.search.ompl_planner import PlanResult, solve
from services.planner.search.path_check import judge_path
from services.planner.search.samples.sample_order import order_along
from services.planner.settings import PlannerSettings
from services.planner.sources.samples import SampleBatch, SampleSource, SourceTiming

EDGES = 1000
REPEATS = 5


def state_check_s(problem: Problem, range_rad: float, resolution_rad: float) -> float:
    """Seconds a state that is looked at, the fastest of five loops over 1000 edges.

    An edge leads from a free configuration towards a uniform one, as far as the planner's range, the way a
    tree grows. The loop is compiled, so neither OMPL nor the step from OMPL to Python counts: what those take
    belongs to the planner.

    Args:
        problem: whose scenario.
        range_rad: longest edge, in OMPL's metric (the sum over the joints), rad.
        resolution_rad: largest distance between checked states in any joint, rad.
    """
    checker = checker_of(problem.scenario)
    starts, ends = _edges(problem, checker, range_rad)
    edge_test = checker.edge_test(resolution_rad)
    looked = sum(int(edge_test(start, end)[1]) for start, end in zip(starts, ends, strict=True))
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        checker.edge_batch(starts, ends, resolution_rad)
        taken.append(time.perf_counter() - began)
    return min(taken) / looked


def _edges(
    problem: Problem, checker: Checker, range_rad: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    space, rng = problem.space, np.random.default_rng(0)
    drawn = space.sample_uniform(rng, EDGES)
    starts = np.concatenate([np.stack([problem.start, problem.goal]), drawn[checker.valid_batch(drawn)]])
    starts = starts[rng.integers(0, len(starts), EDGES)]
    gaps = space.difference(starts, space.sample_uniform(rng, EDGES))
    lengths = np.abs(gaps).sum(axis=1, keepdims=True)
    ends = space.wrap(starts + gaps * np.minimum(1.0, range_rad / np.maximum(lengths, 1e-12)))
    return starts, ends


def measure(
    unit: Unit, setting: Setting, specs: Mapping[str, SourceSpec], sources: Mapping[str, SampleSource]
) -> list[Run]:
    """Run the arms of a unit; nothing that a run holds depends on another unit.

    Args:
        unit: problem, run and arms.
        setting: the limits.
        specs: the samplers by name.
        sources: those that are open, by name.

    Raises:
        SamplerError: a sampler does not answer: a run without its samples would measure another arm.
    """
    problem = known_problem(setting.world, unit.family, setting.split, setting.seed, unit.index)
    seed = planner_seed(setting.seed, unit.index, unit.run)

    # Arms that ask for the same share a batch, and all of them count its time.
    @cache
    def asked(sampler: str, query: SampleQuery) -> SampleBatch:
        return ask(sources[sampler], specs[sampler], problem, query)

    range_rad = workshop_of(setting.world).measures.range_rad
    check_s = _state_check_s(problem, range_rad, setting.resolution_rad)
    runs = []
    # In an order of their own in every unit: no arm is always the one that finds the caches warm.
    for position in np.random.default_rng([seed, 1]).permutation(len(unit.arms)):
        arm = unit.arms[position]
        batch = None if arm.sampler is None else asked(arm.sampler, arm.query(seed))
        settings = setting.planner(arm, unit.index, unit.run)
        began = time.perf_counter()
        samples = None if batch is None else drawn_samples(arm, batch, problem)
        order_s = time.perf_counter() - began
        result = solve(problem, settings, samples, 1.0 - arm.learned_share)
        # Putting the samples in order is work of the planner's side.
        result = replace(result, solve_time_s=result.solve_time_s + order_s)
        runs.append(_record(unit, setting, arm, problem, settings, result, batch, check_s))
    return sorted(runs, key=lambda run: run.arm)


def drawn_samples(arm: Arm, batch: SampleBatch, problem: Problem) -> NDArray[np.float32]:
    """The samples (n, d) rad in the order in which a planner is to draw them."""
    if arm.ordered:
        space = problem.space
        return batch.samples[order_along(batch.samples, problem.start, problem.goal, space)]
    one_kind = arm.in_order or len(arm.epsilon_sigma) == 1
    return batch.samples if one_kind else mixed(batch.samples, batch.seed)


@lru_cache(maxsize=4)
def known_problem(world: World, family: str, split: Split, seed: int, index: int) -> Problem:
    """A problem, kept for the next run on it: a narrow one takes half a second to find."""
    return workshop_of(world).problem(family, split, seed, index)


_state_check_s = lru_cache(maxsize=4)(state_check_s)


def _record(
    unit: Unit,
    setting: Setting,
    arm: Arm,
    problem: Problem,
    settings: PlannerSettings,
    result: PlanResult,
    batch: SampleBatch | None,
    check_s: float,
) -> Run:
    # Whatever the planner says of itself, the path is judged here.
    judged = judge_path(problem, result.path, settings.resolution_rad) if result.solved else result.reason
    solved = judged == Reason.SOLVED
    costs = result.costs if solved else ()
    request_s = 0.0 if batch is None else batch.round_trip_s
    checked_s, timing = result.state_checks * check_s, _timing(batch)
    first = _first(result) if solved else None
    return Run(
        protocol=setting.protocol.value,
        family=unit.family,
        problem=unit.index,
        run=unit.run,
        seed=settings.seed,
        arm=arm.name,
        group=arm.group.value,
        planner=arm.planner,
        sampler=arm.sampler,
        learned_share=arm.learned_share,
        samples_asked=arm.samples,
        samples_got=0 if batch is None else len(batch.samples),
        epsilon_sigma=arm.epsilon_sigma,
        min_confidence=arm.min_confidence,
        range_rad=arm.range_rad,
        stop_at_first=arm.stop_at_first,
        iteration_limit=settings.max_iterations,
        time_limit_s=settings.time_limit_s,
        solved=solved,
        reason=str(judged),
        iterations=result.iterations,
        edge_checks=result.edge_checks,
        state_checks=result.state_checks,
        learned_drawn=result.learned_drawn,
        uniform_drawn=result.uniform_drawn,
        solve_s=result.solve_time_s,
        state_check_s=check_s,
        check_s=checked_s,
        plan_s=result.solve_time_s - checked_s,
        request_s=request_s,
        decode_s=timing.decode_s,
        encode_s=timing.encode_s,
        generate_s=timing.generate_s,
        server_s=timing.total_s,
        transport_s=request_s - timing.total_s,
        total_s=request_s + result.solve_time_s,
        length_rad=float(result.length_rad) if solved else None,
        first_iterations=None if first is None else first.iterations,
        first_edge_checks=None if first is None else first.edge_checks,
        first_s=None if first is None else first.time_s,
        first_length_rad=None if first is None else first.length_rad,
        cost_iterations=tuple(point.iterations for point in costs),
        cost_edge_checks=tuple(point.edge_checks for point in costs),
        cost_s=tuple(point.time_s for point in costs),
        cost_length_rad=tuple(point.length_rad for point in costs),
        novelty=None if batch is None else batch.novelty,
        bottleneck_rad=finite(problem.bottleneck_rad),
    )


def _timing(batch: SampleBatch | None) -> SourceTiming:
    """Where a request's time went; of a source that does not tell, all of it is transport."""
    return SourceTiming(0.0, 0.0, 0.0, 0.0) if batch is None or batch.timing is None else batch.timing


def _first(result: PlanResult) -> CostPoint:
    """The first solution: of an optimising search the first improvement, of any other the end."""
    end = CostPoint(result.iterations, result.edge_checks, result.solve_time_s, float(result.length_rad))
    return result.costs[0] if result.costs else end
