"""Units of the benchmark spread over a Ray cluster or over processes of this machine."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache

from services.evaluator.benchmark.arms import Protocol, Setting, Unit
from services.evaluator.benchmark.plans import PlanWorker
from services.evaluator.benchmark.runs import Row
from services.evaluator.benchmark.samples import SampleWorker
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.cluster import on_cluster, spread

Execute = Callable[[Sequence[Unit], Setting, Sequence[SourceSpec]], Iterator[list[Row]]]
Shared = tuple[Setting, tuple[SourceSpec, ...]]


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


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only.

    A lost worker's unit is run again.

    Args:
        environment: that may name a cluster.
        count: of processes on this machine otherwise, one core each.
    """
    processes = None if on_cluster(environment) else count
    remedy = "give the command again: it goes on from the runs that it has"

    def execute(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Row]]:
        return spread(run_unit, work, (setting, tuple(specs)), "benchmark", remedy, processes)

    return execute
