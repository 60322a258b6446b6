"""Units spread over processes of this machine: one solve at a time in each, as OMPL wants it."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from typing import Any, Protocol, TypeVar

from cspace.errors import JobError
from services.evaluator.benchmark.runs.measure import measure
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.setting import Setting, Unit
from services.evaluator.benchmark.runs.sources import SourceSpec, opened
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
