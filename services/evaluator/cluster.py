"""Units of work spread over a Ray cluster; Ray is used here alone in the evaluator."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import ray
from ray.exceptions import RayError, RayTaskError

from cspace.errors import CspaceError, JobError

Unit = TypeVar("Unit")
Shared = TypeVar("Shared")
Result = TypeVar("Result")

# More than any cluster here has cores; the rest of the work waits in this process.
IN_FLIGHT = 256


def spread(
    run: Callable[[Unit, Shared], Result], work: Sequence[Unit], shared: Shared, what: str
) -> Iterator[Result]:
    """Results as they come from the cluster that RAY_ADDRESS names; a lost worker's unit is run again.

    Args:
        run: one unit with what all share, on one core; a function of a module, so that workers find it.
        work: the units.
        shared: put into the object store once; a node fetches it once.
        what: the whole is, for messages: "evaluation".

    Raises:
        JobError: the cluster does not answer, or a unit failed for good.
        CspaceError: what the unit itself raised.
    """
    try:
        if not ray.is_initialized():
            ray.init(log_to_driver=False, logging_level=logging.WARNING, include_dashboard=False)
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
        raise JobError(f"a unit of the {what} failed", got=str(error.cause)) from error
    except (RayError, ConnectionError) as error:
        raise JobError(f"the cluster lost the {what}", got=str(error)) from error


def on_cluster(environment: Mapping[str, str]) -> bool:
    """Whether RAY_ADDRESS names a cluster that work can be spread over; its http form only takes jobs."""
    address = environment.get("RAY_ADDRESS", "")
    return bool(address) and not address.startswith("http")
