"""uvicorn's configuration, with what this server adds; light to import, for it is made before all else."""

import sys
from typing import TYPE_CHECKING

import uvicorn

from inference_api.connections.limits import ConnectionLimits, within_open_files
from inference_api.connections.table import ConnectionTable
from inference_api.ending import end_in_time

if TYPE_CHECKING:
    from inference_api.telemetry.metrics import Metrics

KEEP_ALIVE_S = 60
SWITCH_S = 0.00005


class ApiConfig(uvicorn.Config):
    """The configuration of one server; it travels to each of its processes, where it is loaded.

    Args:
        limits: of connections.
        grace_s: for requests in flight when the server is told to end, in whole s.
        workers: processes.
        log_config: for :func:`logging.config.dictConfig`.
        load_planner: whether the search of plans is loaded before the server is ready.
    """

    table: ConnectionTable
    metrics: "Metrics"

    def __init__(
        self,
        limits: ConnectionLimits,
        grace_s: int,
        workers: int,
        log_config: dict[str, object],
        *,
        load_planner: bool,
    ) -> None:
        super().__init__(
            "inference_api.app:create_app",
            factory=True,
            http="inference_api.connections.protocol:BoundedProtocol",
            # A request to upgrade is answered as a request, by the guards and the pages.
            ws="none",
            workers=workers,
            timeout_keep_alive=KEEP_ALIVE_S,
            timeout_graceful_shutdown=grace_s,
            log_config=log_config,
            # The app writes one line a request of its own, and knows which proxies it trusts.
            access_log=False,
            proxy_headers=False,
            server_header=False,
        )
        self.limits = limits
        self.grace_s = grace_s
        self.load_planner = load_planner

    def load(self) -> None:
        """Load the app, in the process that serves and after uvicorn has taken the signals."""
        super().load()
        # A request comes back to the interpreter after every graph, and would each time wait for 5 ms while
        # the event loop is busy with somebody's small requests.
        sys.setswitchinterval(SWITCH_S)
        self.metrics = self.loaded_app.state.metrics
        self.loaded_app.state.loads_planner = self.load_planner
        self.limits = within_open_files(self.limits)
        self.table = ConnectionTable(self.limits, self.metrics.connections)
        end_in_time(self.grace_s)
