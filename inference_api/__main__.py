"""``python -m inference_api``: serve the API on loopback."""

import argparse
import os
import signal
import socket
import sys

import uvicorn

from cspace.errors import ConfigError, PortTakenError
from inference_api.auth import check_exposure
from inference_api.settings import HOSTS, WORKBENCH, ApiSettings, bracketed, described_settings
from inference_api.telemetry import LOG_FORMS, log_settings

KEEP_ALIVE_S = 60
# Of request line and headers together.
MAX_HEAD_BYTES = 40 * 1024


def main(arguments: list[str] | None = None) -> int:
    """Parse, listen, serve; 0 after a shutdown, 1 when it could not start, 2 for wrong settings."""
    options = _parser().parse_args(arguments)
    if options.workbench:
        # The processes of the server read it again.
        os.environ[WORKBENCH] = "1"
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        settings = ApiSettings.from_environment()
        check_exposure(options.host, settings.api_keys_file, allowed=options.allow_unauthenticated)
        if options.host not in ("0.0.0.0", "::", ""):  # noqa: S104 - all addresses have no name of their own
            os.environ[HOSTS] = ",".join((*settings.api_hosts, bracketed(options.host)))
        listener = _listen(options.host, options.port)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except PortTakenError as error:
        print(error, file=sys.stderr)
        return 1
    host, port = listener.getsockname()[:2]
    print(f"serving on http://{host}:{port} (documentation at http://{host}:{port}/docs)", flush=True)
    return _serve(settings, options.log, listener)


def _parser() -> argparse.ArgumentParser:
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
        "--allow-unauthenticated",
        action="store_true",
        help="listen on other addresses than loopback although no key is required",
    )
    parser.add_argument(
        "--workbench",
        action="store_true",
        help="ground truth for the page at /: collision regions, families, checks of paths",
    )
    return parser


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio sets TCP_NODELAY on connections of sockets that name their protocol.
    listener = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        # Who connects before the app has started waits.
        listener.listen()
    except (OSError, OverflowError) as error:
        raise PortTakenError(
            f"cannot listen on {host}:{port}", got=str(error), remedy="choose another --port or --host"
        ) from error
    return listener


def _serve(settings: ApiSettings, log: str, listener: socket.socket) -> int:
    config = uvicorn.Config(
        "inference_api.app:create_server_app",
        factory=True,
        # Unlike httptools it bounds a request's head.
        http="h11",
        # A request to upgrade is answered as a request, by the limits and the routes.
        ws="none",
        limit_concurrency=settings.api_max_connections,
        timeout_keep_alive=KEEP_ALIVE_S,
        timeout_graceful_shutdown=settings.api_grace_s,
        h11_max_incomplete_event_size=MAX_HEAD_BYTES,
        forwarded_allow_ips=list(settings.api_trusted_proxies),
        log_config=log_settings(log),
        # The app writes one line a request of its own.
        access_log=False,
        server_header=False,
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(number, lambda *_: sys.exit(0))
    server = uvicorn.Server(config)
    server.run(sockets=[listener])
    return 0 if server.started else 1


if __name__ == "__main__":
    sys.exit(main())
