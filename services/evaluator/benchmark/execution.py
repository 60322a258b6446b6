"""Units of the benchmark spread over a Ray cluster or over processes of this machine."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from functools import lru_cache
from typing import Any, Protocol, TypeVar

from cspace.errors import JobError
from services.evaluator.benchmark.arms import Setting, Unit
from services.evaluator.benchmark.measure import measure
from services.evaluator.benchmark.sources import SourceSpec, opened
from services.evaluator.benchmark.store import Run
from services.evaluator.cluster import on_cluster, spread
from services.evaluator.processes import end_with_parent

Work = TypeVar("Work")
Work_contra = TypeVar("Work_contra", contravariant=True)
Limits = TypeVar("Limits")
Found = TypeVar("Found")


class Works(Protocol[Work_contra, Found]):
    """What a process keeps between units."""

    def run(self, unit: Work_contra) -> list[Found]:
        """One unit."""


Make = Callable[[Limits, Sequence[SourceSpec]], Works[Work, Found]]
Executes = Callable[[Sequence[Work], Limits, Sequence[SourceSpec]], Iterator[list[Found]]]
Execute = Executes[Unit, Setting, Run]
# Each process computes on one core; the pools of numeric libraries would fight over the others.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Worker:
    """What a process keeps between units: the setting, and the samplers, which stay open as long as it does.

    Raises:
        SamplerError: a sampler does not answer.
    """

    def __init__(self, setting: Setting, specs: Sequence[SourceSpec]) -> None:
        self._setting, self._specs = setting, {spec.name: spec for spec in specs}
        self._open = ExitStack()
        self._sources = self._open.enter_context(opened(specs, setting.world))

    def run(self, unit: Unit) -> list[Run]:
        """One unit."""
        return measure(unit, self._setting, self._specs, self._sources)


def processes(count: int) -> Execute:
    """Units over so many spawned processes of this machine."""
    return spawned(Worker, count)


def spawned(make: Make[Limits, Work, Found], count: int) -> Executes[Work, Limits, Found]:
    """The same with workers of another make, a class of a module."""

    def run_spawned(
        work: Sequence[Work], setting: Limits, specs: Sequence[SourceSpec]
    ) -> Iterator[list[Found]]:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, context, _begin, (make, setting, tuple(specs)))
        try:
            futures: list[Future[list[Found]]] = [pool.submit(_run, unit) for unit in work]
            for done in as_completed(futures):
                yield done.result()
        except BrokenProcessPool as error:
            raise JobError(
                "a process of the benchmark ended",
                got=str(error),
                remedy="give the command again: it goes on from the runs that it has",
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)

    return run_spawned


_here: list[Works[Any, Any] | Exception] = []


def _begin(make: Make[Any, Any, Any], setting: Any, specs: Sequence[SourceSpec]) -> None:
    end_with_parent()
    # An error here would break the pool without its words; the first unit raises it instead.
    try:
        _here[:] = [make(setting, specs)]
    except Exception as error:  # noqa: BLE001 - whatever it is, it is raised again
        _here[:] = [error]


def _run(unit: Any) -> list[Any]:
    (worker,) = _here
    if isinstance(worker, Exception):
        raise worker
    return worker.run(unit)


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Run]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: what the unit itself raised.
    """
    return spread(_run_on_ray, work, (Worker, setting, tuple(specs)), "benchmark")


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only.

    Args:
        environment: that may name a cluster.
        count: of processes on this machine otherwise.
    """
    return run_on_ray if on_cluster(environment) else processes(count)


def executor_of(
    make: Make[Limits, Work, Found], environment: Mapping[str, str], count: int
) -> Executes[Work, Limits, Found]:
    """The same for workers of another make, a class of a module."""

    def run(work: Sequence[Work], setting: Limits, specs: Sequence[SourceSpec]) -> Iterator[list[Found]]:
        return spread(_run_on_ray, work, (make, setting, tuple(specs)), "benchmark")

    return run if on_cluster(environment) else spawned(make, count)


def _run_on_ray(unit: Any, shared: tuple[Make[Any, Any, Any], Any, tuple[SourceSpec, ...]]) -> list[Any]:
    return _worker(*shared).run(unit)


@lru_cache(maxsize=1)
def _worker(make: Make[Any, Any, Any], setting: Any, specs: tuple[SourceSpec, ...]) -> Works[Any, Any]:
    return make(setting, specs)
