"""RRT-Connect that draws from an array of samples, which OMPL's can not.

Source: Kuffner and LaValle, RRT-Connect: An Efficient Approach to Single-Query Path Planning, ICRA 2000, with
the steps, the metric (the sum over the joints) and the order of OMPL's, so that with uniform samples the two
differ by chance alone.
"""

import time

import numpy as np
from numba import njit
from numpy.typing import NDArray

from cspace.space import JointSpace
from cspace.worlds.planar.collision import TWO_PI, CollisionChecker, arm_is_free, checked_edge
from cspace.worlds.planar.problems import Problem
from services.planner.plan_result import PlanResult, Reason, SearchTree
from services.planner.search.outcome import Counts, outcome
from services.planner.search.sample_order import colliding_last
from services.planner.settings import PlannerSettings

# Iterations between two looks at the clock.
_BLOCK = 64
_TRAPPED, _ADVANCED, _REACHED = 0, 1, 2


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
    space = problem.scenario.robot.space
    checker = CollisionChecker(problem.scenario)
    began = time.perf_counter()
    looked_at = 0
    if samples is not None and settings.colliding_last:
        samples, looked_at = samples[colliding_last(samples, checker)], len(samples)
    sorted_s = time.perf_counter() - began
    states, learned = drawn_states(space, samples, uniform_share, settings)
    farthest = int(np.ceil(space.dim * np.pi / settings.range_rad)) + 2
    trees = _Trees(space.wrap(problem.start), space.wrap(problem.goal), _BLOCK * farthest)
    fixed = (settings.range_rad, settings.resolution_rad, *checker.kernel_args)
    # A process's first call loads the compiled kernel, which is no part of a search.
    checks = np.array([0, looked_at], dtype=np.int64)
    _advance(trees.nodes, trees.parents, trees.counts, checks, states[:0], 0, *fixed)
    iterations, side, joint = 0, 0, (-1, -1)
    began, reason = time.perf_counter(), Reason.ITERATION_LIMIT
    while iterations < len(states) and joint[0] < 0:
        if time.perf_counter() - began >= settings.time_limit_s:
            reason = Reason.TIME_LIMIT
            break
        trees.make_room()
        block = states[iterations : iterations + _BLOCK]
        done, side, *joint = _advance(trees.nodes, trees.parents, trees.counts, checks, block, side, *fixed)
        iterations += done
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


@njit(cache=True, nogil=True)
def _advance(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, states, side, reach, resolution,
    links, half_width, discs, lower, upper, periodic,
):  # fmt: skip
    """Grow by a block of states: iterations, whose turn it is, the shared node or -1 twice.

    ``checks`` counts on: edges, and states within them and alone.
    """
    for index in range(states.shape[0]):
        other = 1 - side
        status = _grow(
            nodes, parents, counts, checks, side, states[index], reach, resolution,
            links, half_width, discs, lower, upper, periodic,
        )  # fmt: skip
        if status != _TRAPPED:
            target = nodes[side, counts[side] - 1].copy()
            status = _ADVANCED
            while status == _ADVANCED:
                status = _grow(
                    nodes, parents, counts, checks, other, target, reach, resolution,
                    links, half_width, discs, lower, upper, periodic,
                )  # fmt: skip
            if status == _REACHED:
                first, second = counts[0] - 1, counts[1] - 1
                return index + 1, other, first, second
        side = other
    return states.shape[0], side, -1, -1


@njit(cache=True, nogil=True)
def _grow(  # type: ignore[no-untyped-def]
    nodes, parents, counts, checks, side, target, reach, resolution,
    links, half_width, discs, lower, upper, periodic,
):  # fmt: skip
    """One step of a tree towards a configuration: trapped, advanced or reached."""
    dim = target.shape[0]
    nearest, least = 0, np.inf
    for node in range(counts[side]):
        distance = 0.0
        for joint in range(dim):
            distance += abs(_gap(nodes[side, node, joint], target[joint], periodic[joint]))
        if distance < least:
            nearest, least = node, distance
    share = min(1.0, reach / least) if least > 0.0 else 1.0
    new = np.empty(dim)
    for joint in range(dim):
        begin = nodes[side, nearest, joint]
        new[joint] = begin + share * _gap(begin, target[joint], periodic[joint])
        if periodic[joint]:
            new[joint] = (new[joint] + np.pi) % TWO_PI - np.pi
    if share == 1.0:
        new[:] = target
    # The goal's tree looks at the new state before its edge, as OMPL's does.
    if side == 1:
        checks[1] += 1
        if not arm_is_free(new, links, half_width, discs, lower, upper, periodic):
            return _TRAPPED
    free, states = checked_edge(
        nodes[side, nearest], new, resolution, links, half_width, discs, lower, upper, periodic
    )
    checks[0] += 1
    checks[1] += states
    if not free:
        return _TRAPPED
    nodes[side, counts[side]] = new
    parents[side, counts[side]] = nearest
    counts[side] += 1
    return _REACHED if share == 1.0 else _ADVANCED


@njit(cache=True, nogil=True)
def _gap(begin, end, wraps):  # type: ignore[no-untyped-def]
    """The way from one angle to another, the shorter one on a circle."""
    gap = end - begin
    return (gap + np.pi) % TWO_PI - np.pi if wraps else gap
