"""Units spread over a Ray cluster; Ray is used here alone in the benchmark."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache

import ray
from ray.exceptions import RayError, RayTaskError

from cspace.errors import CspaceError, JobError
from services.evaluator.benchmark.runs import Run
from services.evaluator.benchmark.setting import Setting, Unit
from services.evaluator.benchmark.sources import SourceSpec
from services.evaluator.benchmark.spread import Execute, Worker, processes

# More than any cluster here has cores; the rest of the work waits in this process.
IN_FLIGHT = 256


def run_on_ray(work: Sequence[Unit], setting: Setting, specs: Sequence[SourceSpec]) -> Iterator[list[Run]]:
    """Runs as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: what the unit itself raised.
    """
    try:
        if not ray.is_initialized():
            ray.init(log_to_driver=False, logging_level=logging.WARNING, include_dashboard=False)
        task = ray.remote(num_cpus=1, max_retries=2)(_run)
        shared = ray.put((setting, tuple(specs)))
        waiting = [task.remote(unit, shared) for unit in work[:IN_FLIGHT]]
        following = iter(work[IN_FLIGHT:])
        while waiting:
            done, waiting = ray.wait(waiting, num_returns=1)
            yield ray.get(done[0])
            waiting += [task.remote(unit, shared) for unit in [next(following, None)] if unit is not None]
    except RayTaskError as error:
        if isinstance(error.cause, CspaceError):
            raise error.cause from error
        raise JobError("a unit of the benchmark failed", got=str(error.cause)) from error
    except (RayError, ConnectionError) as error:
        raise JobError("the cluster lost the benchmark", got=str(error)) from error


def executor(environment: Mapping[str, str], count: int) -> Execute:
    """Over the cluster where RAY_ADDRESS names one; its http form is for submitting jobs only.

    Args:
        environment: that may name a cluster.
        count: of processes on this machine otherwise.
    """
    address = environment.get("RAY_ADDRESS", "")
    return run_on_ray if address and not address.startswith("http") else processes(count)


def _run(unit: Unit, shared: tuple[Setting, tuple[SourceSpec, ...]]) -> list[Run]:
    return _worker(*shared).run(unit)


@lru_cache(maxsize=1)
def _worker(setting: Setting, specs: tuple[SourceSpec, ...]) -> Worker:
    return Worker.start(setting, specs)
