"""Whole jobs side by side on a cluster: the driver of each is a Ray task that claims nothing for itself."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import ray
from ray.exceptions import RayError

from services.evaluator.cluster import cancel

# How long jobs that were asked to end may take.
STOP_S = 30.0

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Look(Generic[Item, Result]):
    """What a look at the jobs shows.

    Args:
        ended: a job that has ended since, with what it returned or why the cluster lost it; None if none has.
        began: jobs that run, and when they were handed out, by the monotonic clock.
    """

    ended: tuple[Item, Result | RayError] | None
    began: dict[Item, float]


def run_side_by_side(
    items: Sequence[Item],
    run: Callable[[Item], Result],
    at_once: int,
    look_every_s: float,
    stop: Callable[[Item], None],
) -> Iterator[Look[Item, Result]]:
    """Run a job for each item, so many at once; yields whenever one ends, and now and then.

    Drivers are spread over the nodes and take no processor from the trials, whose claims decide what fits. A
    driver whose node dies is started again elsewhere, so ``run`` has to go on where it was.

    Args:
        items: hashable and small.
        run: the job of one item, in a process of its own.
        at_once: one or more.
        look_every_s: the longest time between two looks.
        stop: asks a job to end soon, without loss; called for those that run when the caller goes.
    """
    task = ray.remote(num_cpus=0, max_retries=2, max_calls=1, scheduling_strategy="SPREAD")(run)
    following = iter(items)
    running: dict[ray.ObjectRef[Result], Item] = {}
    began: dict[Item, float] = {}

    def fill() -> None:
        while len(running) < at_once and (item := next(following, None)) is not None:
            running[task.remote(item)], began[item] = item, time.monotonic()

    try:
        fill()
        while running:
            done, _ = ray.wait(list(running), num_returns=1, timeout=look_every_s)
            ended: tuple[Item, Result | RayError] | None = None
            if done:
                item = running.pop(done[0])
                ended = item, _result(done[0])
                del began[item]
                fill()
            yield Look(ended, dict(began))
    except (KeyboardInterrupt, GeneratorExit):
        # The interrupt may come here, or to the caller, who then closes this generator.
        for item in running.values():
            stop(item)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=STOP_S)
        raise
    finally:
        cancel(list(running))


def _result(reference: "ray.ObjectRef[Result]") -> Result | RayError:
    try:
        result: Result = ray.get(reference)
    except RayError as error:
        return error
    return result
