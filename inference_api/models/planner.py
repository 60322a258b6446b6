"""The compiled search of plans, loaded in the background when the server starts."""

import logging
from threading import Thread
from typing import Literal

from cspace.planning.compiled import load_examples
from inference_api.failures import StartingError
from inference_api.memory import settle

_LOG = logging.getLogger(__name__)
State = Literal["on demand", "loading", "loaded"]


class PlannerStart:
    """Loads or compiles the search in a thread; until :meth:`begin` is called the first plan does it."""

    def __init__(self) -> None:
        self.state: State = "on demand"

    def begin(self) -> None:
        """Start to load; nothing waits for it, and a server without the compiler stays as it is."""
        self.state = "loading"
        Thread(target=self._load, name="planner-start", daemon=True).start()

    def require(self) -> None:
        """Raise StartingError while the search is being loaded."""
        if self.state == "loading":
            raise StartingError(
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
