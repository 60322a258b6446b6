"""The compiled search of plans: loaded in the background by servers, else with the first plan."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Annotated, Literal

from fastapi import Depends, Request

from cspace.plan import load_examples
from inference_api.problems import NO_PLANNER, STARTING, RequestError

_LOG = logging.getLogger(__name__)


class SearchKernels:
    """Whether the search is there."""

    def __init__(self) -> None:
        self.state: Literal["on demand", "loading", "loaded"] = "on demand"

    def begin(self) -> None:
        """Start to load or compile it; nothing waits for that."""
        self.state = "loading"
        Thread(target=self._load, name="kernels", daemon=True).start()

    def require(self) -> None:
        """Raise RequestError while the search is being loaded."""
        if self.state == "loading":
            remedy = "ask again in some seconds; without kernels on disk compiling takes about a minute"
            raise RequestError(STARTING, "the search of plans is being loaded", remedy=remedy)

    def _load(self) -> None:
        try:
            load_examples()
        except ImportError:
            _LOG.info("this server does not plan: the packages of the extra plan are not installed")
        finally:
            # Samples can be asked for all the same, and plans try again.
            self.state = "loaded"


@contextmanager
def needs_kernels() -> Iterator[None]:
    """Answers 501 where a search needs the compiler of the checks, and it is not installed."""
    try:
        yield
    except ImportError as error:
        raise RequestError(
            NO_PLANNER,
            "this server does not plan",
            expected="the packages of the extra plan",
            got=f"no {error.name or 'compiler'}",
            remedy="ask a server that has them, or sample here and plan elsewhere",
        ) from error


async def _kernels_of(request: Request) -> SearchKernels:
    kernels: SearchKernels = request.app.state.kernels
    return kernels


# What routes take.
Kernels = Annotated[SearchKernels, Depends(_kernels_of)]
