"""Units spread over processes of this machine: one solve at a time in each, as OMPL wants it."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack

from cspace.errors import JobError
from services.evaluator.benchmark.runs.measure import measure
from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.setting import Setting, Unit
from services.evaluator.benchmark.runs.sources import SourceSpec, opened

Execute = Callable[[Sequence[Unit], Setting, Sequence[SourceSpec]], Iterator[list[Run]]]
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

    def run_spawned(
        work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]
    ) -> Iterator[list[Run]]:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, context, _begin, (setting, tuple(specs)))
        try:
            futures: list[Future[list[Run]]] = [pool.submit(_run, unit) for unit in work]
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


_here: list[Worker | Exception] = []


def _begin(setting: Setting, specs: Sequence[SourceSpec]) -> None:
    # An error here would break the pool without its words; the first unit raises it instead.
    try:
        _here[:] = [Worker(setting, specs)]
    except Exception as error:  # noqa: BLE001 - whatever it is, it is raised again
        _here[:] = [error]


def _run(unit: Unit) -> list[Run]:
    (worker,) = _here
    if isinstance(worker, Exception):
        raise worker
    return worker.run(unit)
