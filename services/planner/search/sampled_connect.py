"""RRT-Connect that draws from an array of samples, which OMPL's can not.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000, with
the steps, the metric (the sum over the joints) and the order of OMPL's, so that with uniform samples the two
differ by chance alone.
"""

import time

import numpy as np
from numpy.typing import NDArray

from cspace.problem import Problem
from cspace.space import JointSpace
from cspace.worlds import checker_of
from services.planner.plan_result import PlanResult, Reason, SearchTree
from services.planner.search.outcome import Counts, outcome
from services.planner.search.samples.sample_order import colliding_last
from services.planner.settings import PlannerSettings

# Iterations between two looks at the clock.
_BLOCK = 64


class _Trees:
    """The tree of the start and that of the goal, in arrays that grow."""

    def __init__(self, start: NDArray[np.float64], goal: NDArray[np.float64], block: int) -> None:
        # What one block of iterations adds at most to one tree.
        self._block = block
        self.nodes = np.empty((2, 4 * block, len(start)))
        self.parents = np.full((2, 4 * block), -1, dtype=np.int64)
        self.counts = np.ones(2, dtype=np.int64)
        self.nodes[0, 0], self.nodes[1, 0] = start, goal

    def make_room(self) -> None:
        """Room for one more block."""
        if self.counts.max() + self._block > self.nodes.shape[1]:
            self.nodes = np.concatenate([self.nodes, np.empty_like(self.nodes)], axis=1)
            self.parents = np.concatenate([self.parents, np.full_like(self.parents, -1)], axis=1)

    def path(self, joint: tuple[int, int]) -> NDArray[np.float64]:
        """From the start over the node that both trees share to the goal, (k, d)."""
        halves = [self.nodes[side, self._to_root(side, joint[side])] for side in (0, 1)]
        return np.concatenate([halves[0][::-1], halves[1][1:]])

    def copy(self) -> SearchTree:
        """Both trees as one forest."""
        first = int(self.counts[0])
        vertices = np.concatenate([self.nodes[side, : self.counts[side]] for side in (0, 1)])
        edges = [
            np.stack([self.parents[side, 1:count], np.arange(1, count)], axis=1) + side * first
            for side, count in enumerate(self.counts)
        ]
        return SearchTree(vertices, np.concatenate(edges).astype(np.intp))

    def _to_root(self, side: int, node: int) -> list[int]:
        numbers = [node]
        while self.parents[side, numbers[-1]] >= 0:
            numbers.append(int(self.parents[side, numbers[-1]]))
        return numbers


def connect(
    problem: Problem,
    settings: PlannerSettings,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    *,
    keep_tree: bool = False,
) -> PlanResult:
    """Grow both trees until they meet; see :func:`services.planner.search.ompl_planner.solve`.

    Args:
        problem: start and goal, both free.
        settings: of the planner; there is no goal bias.
        samples: (n, d) learned samples in rad, drawn in this order and once each; None for uniform ones.
        uniform_share: share of uniform samples while learned ones are left, 0 to 1.
        keep_tree: whether the result holds both trees.
    """
    space, checker = problem.space, checker_of(problem.scenario)
    began = time.perf_counter()
    looked_at = 0
    if samples is not None and settings.colliding_last:
        samples, looked_at = samples[colliding_last(samples, checker)], len(samples)
    sorted_s = time.perf_counter() - began
    states, learned = drawn_states(space, samples, uniform_share, settings)
    ranges = np.where(space.periodic, np.pi, np.subtract(space.upper, space.lower))
    farthest = int(np.ceil(ranges.sum() / settings.range_rad)) + 2
    trees = _Trees(space.wrap(problem.start), space.wrap(problem.goal), _BLOCK * farthest)
    fixed = (settings.range_rad, settings.resolution_rad)
    # A process's first call loads the compiled kernel, which is no part of a search.
    checks = np.array([0, looked_at], dtype=np.int64)
    checker.grow_trees(trees.nodes, trees.parents, trees.counts, checks, states[:0], 0, *fixed)
    iterations, side, joint = 0, 0, (-1, -1)
    began, reason = time.perf_counter(), Reason.ITERATION_LIMIT
    while iterations < len(states) and joint[0] < 0:
        if time.perf_counter() - began >= settings.time_limit_s:
            reason = Reason.TIME_LIMIT
            break
        trees.make_room()
        block = states[iterations : iterations + _BLOCK]
        done, side, first, second = checker.grow_trees(
            trees.nodes, trees.parents, trees.counts, checks, block, side, *fixed
        )
        iterations, joint = iterations + done, (first, second)
    solve_time_s = time.perf_counter() - began + sorted_s
    learned_drawn = int(learned[:iterations].sum())
    counts = Counts(
        iterations=iterations,
        edge_checks=int(checks[0]),
        state_checks=int(checks[1]),
        solve_time_s=solve_time_s,
        learned_drawn=learned_drawn,
        uniform_drawn=iterations - learned_drawn,
    )
    found = trees.path((joint[0], joint[1])) if joint[0] >= 0 else None
    return outcome(problem, settings, found, reason, counts, tree=trees.copy() if keep_tree else None)


def drawn_states(
    space: JointSpace,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    settings: PlannerSettings,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """All states that a search may draw, (max_iterations, d) rad, and which of them are learned."""
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(2,)))
    states = space.sample_uniform(rng, settings.max_iterations)
    learned = rng.random(len(states)) >= uniform_share
    if samples is None:
        learned[:] = False
        return states, learned
    learned[np.flatnonzero(learned)[len(samples) :]] = False
    states[learned] = space.wrap(samples)[: int(learned.sum())]
    return states, learned
