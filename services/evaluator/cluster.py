"""Ray: how a process joins it, and units of work spread over its cluster."""

import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

import ray
from ray.exceptions import RayError, RayTaskError

from cspace.errors import CspaceError, JobError

Unit = TypeVar("Unit")
Shared = TypeVar("Shared")
Result = TypeVar("Result")

# More than any cluster here has cores; the rest of the work waits in this process.
IN_FLIGHT = 256


def spread(
    run: Callable[[Unit, Shared], Result],
    work: Sequence[Unit],
    shared: Shared,
    what: str,
    remedy: str | None = None,
) -> Iterator[Result]:
    """Results as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    ``run`` is a function of a module, so that workers find it. ``shared`` is put into the object store once,
    ``what`` and ``remedy`` are for messages. An error of the project that a unit raises is raised here.
    """
    waiting: list[ray.ObjectRef[Any]] = []
    try:
        join(log_to_driver=False)
        task = ray.remote(num_cpus=1, max_retries=2)(run)
        stored = ray.put(shared)
        waiting = [task.remote(unit, stored) for unit in work[:IN_FLIGHT]]
        following = iter(work[IN_FLIGHT:])
        while waiting:
            done, waiting = ray.wait(waiting, num_returns=1)
            yield ray.get(done[0])
            waiting += [task.remote(unit, stored) for unit in [next(following, None)] if unit is not None]
    except RayTaskError as error:
        if isinstance(error.cause, CspaceError):
            raise error.cause from error
        raise JobError(f"a unit of the {what} failed", got=str(error.cause), remedy=remedy) from error
    except (RayError, ConnectionError) as error:
        raise JobError(f"the cluster lost the {what}", got=str(error), remedy=remedy) from error
    finally:
        with suppress(RayError, ConnectionError):
            cancel(waiting)


def cancel(references: Sequence["ray.ObjectRef[Any]"]) -> None:
    """Cancel the tasks that have not ended.

    Ray ends the whole process when a task is cancelled whose answer is just being taken in ("Tried to
    complete task that was not pending"), so none is cancelled that is known to be over.
    """
    if references:
        _, left = ray.wait(list(references), num_returns=len(references), timeout=0)
        for reference in left:
            ray.cancel(reference)


def join(**settings: Any) -> None:
    """Join the cluster that RAY_ADDRESS names or that runs here; for its http form, start a local one."""
    if not ray.is_initialized():
        address = "local" if _takes_jobs_only(os.environ) else None
        ray.init(address, logging_level=logging.WARNING, include_dashboard=False, **settings)


def on_cluster(environment: Mapping[str, str]) -> bool:
    """Whether RAY_ADDRESS names a cluster that work can be spread over; its http form only takes jobs."""
    return bool(environment.get("RAY_ADDRESS")) and not _takes_jobs_only(environment)


def _takes_jobs_only(environment: Mapping[str, str]) -> bool:
    return environment.get("RAY_ADDRESS", "").startswith("http")
