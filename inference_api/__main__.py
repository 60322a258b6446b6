"""``python -m inference_api``: serve the API on loopback."""

import argparse
import logging
import os
import signal
import socket
import sys

import uvicorn

from cspace.errors import ConfigError, PortTakenError
from inference_api.settings import ApiSettings

DESCRIPTION = (
    "Serve POST /sample. Settings: MLFLOW_TRACKING_URI (registry; none serves the shipped model only), "
    "CSPACE_MODEL_CACHE, CSPACE_MODEL_NAME, CSPACE_MODEL_POLL_S, CSPACE_PRETRAINED_MODEL, "
    "CSPACE_LOADED_MODELS, CSPACE_CACHED_PICTURES."
)


def main(arguments: list[str] | None = None) -> int:
    """Parse, listen, serve; 0 after a shutdown, 1 when it could not start, 2 for wrong settings."""
    parser = argparse.ArgumentParser(prog="python -m inference_api", description=DESCRIPTION)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8000, help="0 for a free one (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        _prepare(ApiSettings.from_environment())
        listener = _listen(options.host, options.port)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except PortTakenError as error:
        print(error, file=sys.stderr)
        return 1
    host, port = listener.getsockname()[:2]
    print(f"serving on http://{host}:{port} (documentation at http://{host}:{port}/docs)", flush=True)
    config = uvicorn.Config(
        "inference_api.app:create_app",
        factory=True,
        timeout_keep_alive=60,
        timeout_graceful_shutdown=10,
    )
    server = uvicorn.Server(config)
    server.run(sockets=[listener])
    return 0 if server.started else 1


def _prepare(settings: ApiSettings) -> None:
    """What holds for the whole process, before anything heavy is imported."""
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    if settings.registry_uri is not None:
        # Not above, for it brings MLflow with it, and an API without a registry does without.
        from services.registry.mlflow_health import lower_patience  # noqa: PLC0415

        lower_patience(os.environ)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s:     %(message)s")
    logging.getLogger("inference_api").setLevel(logging.INFO)
    for number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(number, lambda *_: sys.exit(0))


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family)
    except (OSError, OverflowError) as error:
        raise PortTakenError(
            f"cannot listen on {host}:{port}", got=str(error), remedy="choose another --port or --host"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
