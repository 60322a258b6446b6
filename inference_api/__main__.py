"""``python -m inference_api``: serve the API on loopback."""

import argparse
import os
import signal
import sys

import uvicorn

from cspace.errors import ConfigError
from inference_api.app import create_app
from inference_api.limits import LOOPBACK_NAMES
from inference_api.settings import ApiSettings, bracketed
from inference_api.telemetry import configure_logging
from services.commands import number, settings_of

PORT = number("0 to 65535", 0, 65535, int)


def main(arguments: list[str] | None = None) -> int:
    """Parse and serve; 0 after a shutdown, uvicorn's codes when it could not start, 2 for wrong settings."""
    parser = argparse.ArgumentParser(
        prog="python -m inference_api",
        description="Serve POST /sample and the rest of the API. docs/operations.md lists its settings.",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=PORT, default=8000, help="0 for a free one (default: %(default)s)")
    parser.add_argument(
        "--allow-unauthenticated",
        action="store_true",
        help="listen on other addresses than loopback although no key is required",
    )
    options = parser.parse_args(arguments)
    host = bracketed(options.host)
    try:
        settings = settings_of(ApiSettings)
        if host not in LOOPBACK_NAMES and not settings.api_keys_file and not options.allow_unauthenticated:
            parser.error(
                f"everybody who reaches {host!r} could use the server: name a file of keys in "
                "CSPACE_API_KEYS_FILE, or say --allow-unauthenticated"
            )
        hosts = {*settings.api_hosts, host} - {"0.0.0.0", "[::]", ""}  # noqa: S104
        app = create_app(settings.model_copy(update={"api_hosts": hosts}))
    except ConfigError as error:
        parser.error(str(error))
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    configure_logging()
    app.state.loads_planner = settings.api_load_planner
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(signal_number, lambda *_: sys.exit(0))
    uvicorn.run(
        app,
        host=options.host,
        port=options.port,
        # Unlike httptools it bounds a request's head.
        http="h11",
        # A request to upgrade is answered as a request, by the limits and the routes.
        ws="none",
        limit_concurrency=512,
        timeout_keep_alive=60,
        timeout_graceful_shutdown=settings.api_grace_s,
        h11_max_incomplete_event_size=40 * 1024,
        forwarded_allow_ips=[str(network) for network in settings.api_trusted_proxies],
        log_config=None,
        # The app writes one line a request of its own.
        access_log=False,
        server_header=False,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
