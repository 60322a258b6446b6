"""Metrics by name: one function each, in a module of this package, which is found by itself.

A metric takes what its task measures in one scenario (:class:`Samples`, :class:`Head`, :class:`Run` or
``geometry_score.Clouds``), and returns a number or a few that belong together. Its estimates are made of the
values of all scenarios, by default the mean with its interval::

    @metric("mean_joint")
    def mean_joint(group: Samples) -> float:
        return float(group.samples[:, 0].mean())
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from cspace.space import JointSpace
from services.evaluator.statistics import Floats, Interval, mean_interval


class Task(StrEnum):
    """What is measured in a scenario."""

    RECONSTRUCTION = "reconstruction"
    HEAD = "head"
    PLANNING = "planning"
    TOPOLOGY = "topology"


@dataclass(frozen=True, slots=True)
class Samples:
    """(N, d) samples in rad beside (M, d) held-out free configurations of the same scenario."""

    samples: Floats
    held_out: Floats
    space: JointSpace
    is_free: Callable[[Floats], NDArray[np.bool_]]
    coverage_radius_rad: float


@dataclass(frozen=True, slots=True)
class Head:
    """The confidence of uniform configurations (N,), whether they are free, and their clearance.

    ``acceptance`` is the share of the generator's samples that reach the bundle's threshold.
    """

    confidence: NDArray[np.floating]
    free: NDArray[np.bool_]
    clearance_m: NDArray[np.floating]
    acceptance: float
    near_contact_m: float


@dataclass(frozen=True, slots=True)
class Run:
    """One run of a planner on one problem."""

    success: bool
    iterations: int
    edge_checks: int


# Values (n, k) of a sampler and of uniform samples in the same scenarios, and a generator, to estimates.
# The first estimate is the metric's main one.
Estimates = Callable[[Floats, Floats, np.random.Generator], Mapping[str, Interval]]
Values = float | Sequence[float] | Floats
Measure = TypeVar("Measure", bound=Callable[[Any], Values])


@dataclass(frozen=True, slots=True)
class Metric:
    """A registered metric. Its main estimate is logged to MLflow for the samplers in ``logged``."""

    name: str
    task: Task
    measure: Callable[[Any], Values]
    estimates: Estimates
    logged: tuple[str, ...]
    by_family: bool


_METRICS: dict[tuple[Task, str], Metric] = {}


def metric(
    name: str,
    task: Task = Task.RECONSTRUCTION,
    *,
    estimates: Estimates | None = None,
    logged: Sequence[str] = ("sampler", "confident", "learned", ""),
    by_family: bool = False,
) -> Callable[[Measure], Measure]:
    """Register a function as a metric; ``by_family`` logs it for the other families of scenes as well."""

    def register(measure: Measure) -> Measure:
        made = estimates or (lambda values, _, rng: {name: mean_interval(values[:, 0], rng)})
        _METRICS[task, name] = Metric(name, task, measure, made, tuple(logged), by_family)
        return measure

    return register


def metrics_of(task: Task) -> list[Metric]:
    """All metrics of a task."""
    _discover()
    return [one for one in _METRICS.values() if one.task == task]


def measured(task: Task, given: Any) -> Iterator[tuple[str, int, float]]:
    """Name, part and value of every metric of a task."""
    for one in metrics_of(task):
        for part, value in enumerate(np.atleast_1d(one.measure(given)).tolist()):
            yield one.name, part, float(value)


@cache
def _discover() -> None:
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
