"""``python -m inference_api``: serve the API on loopback."""

import argparse
import os
import signal
import socket
import sys
import tempfile

import uvicorn
from prometheus_client.multiprocess import mark_process_dead
from uvicorn.config import STARTUP_FAILURE
from uvicorn.supervisors import Multiprocess

from cspace.errors import ConfigError, PortTakenError
from inference_api.keys import check_exposure
from inference_api.logs import LOG_FORMS, log_settings
from inference_api.process import end_in_time
from inference_api.server import ApiConfig, SharedPort
from inference_api.settings import (
    HOSTS,
    METRICS_FOLDER,
    THREADS,
    WORKBENCH,
    ApiSettings,
    bracketed,
    described_settings,
    is_wildcard,
    usable_cores,
)

# Uvicorn's supervisor looks at its signals twice a second.
SUPERVISOR_MARGIN_S = 0.5


def main(arguments: list[str] | None = None) -> int:
    """Parse, listen, serve; 0 after a shutdown, 1 when it could not start, 2 for wrong settings.

    A shutdown that threads hold up ends the process with 3.
    """
    parser = argparse.ArgumentParser(
        prog="python -m inference_api",
        description="Serve POST /sample and the rest of the API.",
        epilog="\n".join(("settings, as environment variables:", *described_settings())),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8000, help="0 for a free one (default: %(default)s)")
    parser.add_argument(
        "--log", choices=LOG_FORMS, default="text", help="form of the log (default: %(default)s)"
    )
    parser.add_argument(
        "--workers",
        type=_at_least_one,
        default=1,
        help="processes behind the port (default: %(default)s)",
    )
    parser.add_argument(
        "--allow-unauthenticated",
        action="store_true",
        help="listen on other addresses than loopback although no key is required",
    )
    parser.add_argument(
        "--workbench",
        action="store_true",
        help="ground truth for the page at /: collision regions, families, checks of paths",
    )
    options = parser.parse_args(arguments)
    if options.workbench:
        # The processes of the server read it again.
        os.environ[WORKBENCH] = "1"
    try:
        settings = ApiSettings.from_environment()
        check_exposure(options.host, settings.protection.keys_file, allowed=options.allow_unauthenticated)
        _prepare(settings, options.host)
        listener = _listen(options.host, options.port, shared=options.workers > 1)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except PortTakenError as error:
        print(error, file=sys.stderr)
        return 1
    host, port = listener.getsockname()[:2]
    print(f"serving on http://{host}:{port} (documentation at http://{host}:{port}/docs)", flush=True)
    config = ApiConfig(
        settings.connections,
        settings.grace_s,
        options.workers,
        log_config=log_settings(options.log),
        load_planner=settings.load_planner,
    )
    return _serve(config, listener)


def _serve(config: ApiConfig, listener: socket.socket) -> int:
    if config.workers == 1:
        server = uvicorn.Server(config)
        server.run(sockets=[listener])
        return 0 if server.started else 1
    with tempfile.TemporaryDirectory(prefix="cspace-metrics-") as folder:
        os.environ[METRICS_FOLDER] = folder
        # The cores are shared out, or the processes would compute against each other.
        os.environ.setdefault(THREADS, str(max(1, usable_cores() // config.workers)))
        supervisor = _Supervisor(config, [listener])
        # The processes end by themselves in time; this is for what keeps one from even trying.
        end_in_time(config.grace_s + SUPERVISOR_MARGIN_S, lambda: _kill(supervisor))
        supervisor.run()
    return 1 if any(process.exitcode == STARTUP_FAILURE for process in supervisor.processes) else 0


class _Supervisor(Multiprocess):
    """Takes the gauges of processes that have died out of the metrics."""

    def keep_subprocess_alive(self) -> None:
        before = list(self.processes)
        super().keep_subprocess_alive()
        for process in before:
            if process not in self.processes:
                mark_process_dead(process.pid)  # type: ignore[no-untyped-call]


def _kill(supervisor: Multiprocess) -> None:
    for process in supervisor.processes:
        process.process.kill()


def _at_least_one(text: str) -> int:
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number, at least 1, got {text!r}")
    return int(text)


def _prepare(settings: ApiSettings, host: str) -> None:
    """What holds for the whole process and those that it starts, before anything heavy is imported."""
    if not is_wildcard(host):
        os.environ[HOSTS] = ",".join(dict.fromkeys((*settings.protection.hosts, bracketed(host))))
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    for number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(number, lambda *_: sys.exit(0))


def _listen(host: str, port: int, *, shared: bool) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        if shared:
            return SharedPort.taken(host, port, family)
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        raise PortTakenError(
            f"cannot listen on {host}:{port}", got=str(error), remedy="choose another --port or --host"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
