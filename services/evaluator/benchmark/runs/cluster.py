"""Units of the benchmark over a cluster, or over processes of this machine."""

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any

from services.evaluator.benchmark.runs.run import Run
from services.evaluator.benchmark.runs.setting import Setting, Unit
from services.evaluator.benchmark.runs.sources import SourceSpec
from services.evaluator.benchmark.runs.spread import (
    Execute,
    Executes,
    Found,
    Limits,
    Make,
    Work,
    Worker,
    Works,
    processes,
    spawned,
)
from services.evaluator.cluster import on_cluster, spread


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Run]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: what the unit itself raised.
    """
    return spread(_run, work, (Worker, setting, tuple(specs)), "benchmark")


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
        return spread(_run, work, (make, setting, tuple(specs)), "benchmark")

    return run if on_cluster(environment) else spawned(make, count)


def _run(unit: Any, shared: tuple[Make[Any, Any, Any], Any, tuple[SourceSpec, ...]]) -> list[Any]:
    return _worker(*shared).run(unit)


@lru_cache(maxsize=1)
def _worker(make: Make[Any, Any, Any], setting: Any, specs: tuple[SourceSpec, ...]) -> Works[Any, Any]:
    return make(setting, specs)
