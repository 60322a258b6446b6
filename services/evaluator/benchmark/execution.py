"""Units of the benchmark spread over a Ray cluster or over processes of this machine."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from threading import Thread

from cspace.errors import JobError
from services.evaluator.benchmark.arms import Protocol, Setting, Unit
from services.evaluator.benchmark.plans import PlanWorker
from services.evaluator.benchmark.runs import Row
from services.evaluator.benchmark.samples import SampleWorker
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.cluster import on_cluster, spread

Execute = Callable[[Sequence[Unit], Setting, Sequence[SourceSpec]], Iterator[list[Row]]]
Shared = tuple[Setting, tuple[SourceSpec, ...]]
# Each process computes on one core; the thread pools of numeric libraries would compete for the others.
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@lru_cache(maxsize=1)
def worker_of(setting: Setting, specs: tuple[SourceSpec, ...]) -> SampleWorker | PlanWorker:
    """The worker of this process, kept between units.

    Raises:
        SamplerError: a model does not answer.
    """
    return (PlanWorker if setting.protocol is Protocol.PLANS else SampleWorker)(setting, specs)


def run_unit(unit: Unit, shared: Shared) -> list[Row]:
    """One unit in this process.

    Raises:
        SamplerError: a model does not answer.
    """
    return worker_of(*shared).run(unit)


def processes(count: int) -> Execute:
    """Units over so many spawned processes of this machine."""

    def run_spawned(
        work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]
    ) -> Iterator[list[Row]]:
        for name in ONE_THREAD:
            os.environ.setdefault(name, "1")
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(count, context, _begin, ((setting, tuple(specs)),))
        try:
            for done in as_completed([pool.submit(_run, unit) for unit in work]):
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


_shared: list[Shared] = []


def end_with_parent() -> None:
    """In a process of a pool: end when the process that made it has ended, in whatever way.

    A pool's processes wait for work, and of a parent that was killed nobody tells them.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def follow() -> None:
        parent.join()
        os._exit(1)

    Thread(target=follow, name="parent", daemon=True).start()


def _begin(shared: Shared) -> None:
    end_with_parent()
    _shared[:] = [shared]


def _run(unit: Unit) -> list[Row]:
    return run_unit(unit, _shared[0])


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: the error of a unit.
    """
    return spread(run_unit, work, (setting, tuple(specs)), "benchmark")


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only.

    Args:
        environment: that may name a cluster.
        count: of processes on this machine otherwise.
    """
    return run_on_ray if on_cluster(environment) else processes(count)
