"""The compiled search of plans, loaded in the background when the server starts."""

import logging
import resource
from pathlib import Path
from threading import Thread
from typing import Literal

from cspace.plan import load_examples
from inference_api.problem_types import OUT_OF_RESOURCES, STARTING, RequestError
from inference_api.process import settle

_LOG = logging.getLogger(__name__)
State = Literal["on demand", "loading", "loaded"]
# Address space that the compiler takes with all kernels; were it to run out on the way, nothing would work.
ROOM_BYTES = 512 * 2**20


class PlannerStart:
    """Loads or compiles the search in a thread; until :meth:`begin` is called the first plan does it."""

    def __init__(self) -> None:
        self.state: State = "on demand"

    def begin(self) -> None:
        """Start to load; nothing waits for it. Without the compiler, or room for it, all stays as it is."""
        if not _has_room():
            _LOG.warning("this server does not plan: its limit of address space leaves no room for that")
            return
        self.state = "loading"
        Thread(target=self._load, name="planner-start", daemon=True).start()

    def require(self) -> None:
        """Raise RequestError while the search is being loaded, and where there is no room for it."""
        if self.state == "on demand" and not _has_room():
            raise RequestError(
                OUT_OF_RESOURCES,
                "there is no room for the search of plans",
                expected=f"{ROOM_BYTES // 2**20} MiB of address space below the limit of the process",
                remedy="raise the limit, or ask another server",
            )
        if self.state == "loading":
            raise RequestError(
                STARTING,
                "the search of plans is being loaded",
                expected="a server whose /health/ready says 200",
                got="one that was started a moment ago",
                remedy="ask again in some seconds; without kernels on disk compiling takes about a minute",
            )

    def _load(self) -> None:
        try:
            load_examples()
            settle()
        except ImportError:
            _LOG.info("this server does not plan: the packages of the extra plan are not installed")
        except Exception:  # noqa: BLE001 - samples can be asked for all the same
            _LOG.exception("the search of plans could not be loaded; requests will try again")
        self.state = "loaded"


def _has_room() -> bool:
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return True
    taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    return taken + ROOM_BYTES <= most
