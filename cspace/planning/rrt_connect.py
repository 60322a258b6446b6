"""RRT-Connect, compiled with the checks of any simulator and fed with given states."""

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cspace.simulator import Checker
from cspace.space import JointSpace
from cspace.world import CheckCancelled

# Iterations between two looks at the clock, or pauses.
BLOCK = 64


@dataclass(frozen=True, slots=True)
class Growth:
    """How trees grow."""

    range_rad: float  # longest step, the sum over the joints
    resolution_rad: float  # largest distance between states that are looked at in any joint
    time_limit_s: float = math.inf  # of computing; waiting for others does not count
    check_cancelled: CheckCancelled = lambda: None  # called between blocks of states


@dataclass(frozen=True, slots=True, eq=False)
class Grown:
    """What a search has found and taken."""

    path: NDArray[np.float64] | None  # (k, d) rad from start to goal
    nodes: NDArray[np.float64]  # (V, d) rad, of both trees one after the other
    parents: NDArray[np.int64]  # (V,) the node from which each was reached, -1 for roots
    iterations: int  # states that were drawn
    edge_checks: int
    state_checks: int  # within the edges
    time_s: float  # wall time of the search alone
    timed_out: bool


class Trees:
    """The trees of start and goal, in arrays that grow by at most ``block`` nodes a tree at a time."""

    def __init__(self, start: NDArray[np.float64], goal: NDArray[np.float64], block: int) -> None:
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
        halves = []
        for side, node in enumerate(joint):
            numbers = [node]
            while self.parents[side, numbers[-1]] >= 0:
                numbers.append(int(self.parents[side, numbers[-1]]))
            halves.append(self.nodes[side, numbers])
        return np.concatenate([halves[0][::-1], halves[1][1:]])

    def forest(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Nodes (V, d) rad and parents (V,) of both."""
        first, second = (int(count) for count in self.counts)
        later = self.parents[1, :second].copy()
        later[later >= 0] += first
        nodes = np.concatenate([self.nodes[0, :first], self.nodes[1, :second]])
        return nodes, np.concatenate([self.parents[0, :first], later])


def grow_connect(
    checker: Checker,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    states: NDArray[np.float64],
    growth: Growth,
) -> Grown:
    """Grow a tree from either free end (d,) rad, until they meet or there are no more states (n, d) rad."""
    space = checker.space
    ranges = np.where(space.periodic, np.pi, np.subtract(space.upper, space.lower))
    farthest = int(np.ceil(ranges.sum() / growth.range_rad)) + 2
    trees = Trees(space.wrap(start), space.wrap(goal), BLOCK * farthest)
    fixed = (growth.range_rad, growth.resolution_rad)
    checks = np.zeros(2, dtype=np.int64)
    # A process's first call loads the compiled kernel, which is no part of a search.
    checker.grow_trees(trees.nodes, trees.parents, trees.counts, checks, states[:0], 0, *fixed)
    iterations, side, joint, timed_out = 0, 0, (-1, -1), False
    began, until_s = time.perf_counter(), time.thread_time() + growth.time_limit_s
    while iterations < len(states) and joint[0] < 0:
        timed_out = time.thread_time() >= until_s
        if timed_out:
            break
        trees.make_room()
        block = states[iterations : iterations + BLOCK]
        done, side, first, second = checker.grow_trees(
            trees.nodes, trees.parents, trees.counts, checks, block, side, *fixed
        )
        iterations, joint = iterations + done, (first, second)
        if first < 0:
            growth.check_cancelled()
    time_s = time.perf_counter() - began
    path = trees.path(joint) if joint[0] >= 0 else None
    return Grown(path, *trees.forest(), iterations, int(checks[0]), int(checks[1]), time_s, timed_out)


def sampled_states(
    space: JointSpace,
    samples: NDArray[np.float64] | None,
    uniform_share: float,
    count: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """All states that a search may draw, (count, d) rad, and which of them are learned.

    ``samples``: (n, d) learned ones in rad, in this order and once each; None for uniform ones alone.
    ``uniform_share``: of uniform ones while learned ones are left.
    """
    states = space.sample_uniform(rng, count)
    learned = rng.random(len(states)) >= uniform_share
    if samples is None:
        learned[:] = False
        return states, learned
    learned[np.flatnonzero(learned)[len(samples) :]] = False
    states[learned] = space.wrap(samples)[: int(learned.sum())]
    return states, learned
