"""``python -m inference_api``: serve the API on loopback."""

import argparse
import os
import signal
import socket
import sys

import uvicorn

from cspace.errors import ConfigError
from inference_api.app import create_app
from inference_api.auth import check_exposure
from inference_api.settings import ApiSettings, bracketed
from inference_api.telemetry import configure_logging

MAX_CONNECTIONS, KEEP_ALIVE_S = 512, 60
# Of request line and headers together.
MAX_HEAD_BYTES = 40 * 1024


def main(arguments: list[str] | None = None) -> int:
    """Parse, listen, serve; 0 after a shutdown, 1 when it could not start, 2 for wrong settings."""
    options = _parser().parse_args(arguments)
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    configure_logging()
    try:
        settings = ApiSettings.from_environment()
        check_exposure(options.host, settings.api_keys_file, allowed=options.allow_unauthenticated)
        hosts = {*settings.api_hosts, bracketed(options.host)} - {"0.0.0.0", "[::]", ""}  # noqa: S104
        app = create_app(settings.model_copy(update={"api_hosts": hosts}))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    app.state.loads_planner = settings.api_load_planner
    try:
        family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
        listener = socket.create_server((options.host, options.port), family=family)
    except (OSError, OverflowError) as error:
        print(f"cannot listen: {error}; choose another --port or --host", file=sys.stderr)
        return 1
    host, port = listener.getsockname()[:2]
    print(f"serving on http://{host}:{port} (documentation at http://{host}:{port}/docs)", flush=True)
    config = uvicorn.Config(
        app,
        # Unlike httptools it bounds a request's head.
        http="h11",
        # A request to upgrade is answered as a request, by the limits and the routes.
        ws="none",
        limit_concurrency=MAX_CONNECTIONS,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=settings.api_grace_s,
        h11_max_incomplete_event_size=MAX_HEAD_BYTES,
        forwarded_allow_ips=[str(network) for network in settings.api_trusted_proxies],
        log_config=None,
        # The app writes one line a request of its own.
        access_log=False,
        server_header=False,
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(number, lambda *_: sys.exit(0))
    server = uvicorn.Server(config)
    # Opened again it knows its protocol, without which asyncio leaves Nagle's algorithm on.
    server.run(sockets=[socket.socket(fileno=listener.detach())])
    return 0 if server.started else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m inference_api",
        description="Serve POST /sample and the rest of the API. docs/operations.md lists its settings.",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8000, help="0 for a free one (default: %(default)s)")
    parser.add_argument(
        "--allow-unauthenticated",
        action="store_true",
        help="listen on other addresses than loopback although no key is required",
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
