"""``python -m inference_api``: serve the API on loopback."""

import argparse
import logging
import os
import signal
import socket
import sys

import uvicorn

DESCRIPTION = (
    "Serve POST /sample. Settings: MLFLOW_TRACKING_URI (registry; none serves the shipped model only), \
CSPACE_MODEL_CACHE, CSPACE_MODEL_NAME, CSPACE_MODEL_POLL_S, CSPACE_PRETRAINED_MODEL, CSPACE_LOADED_MODELS."
)


def main(arguments: list[str] | None = None) -> int:
    """Parse, listen, serve; 0 after a shutdown, 1 when it could not start, 2 for wrong arguments."""
    parser = argparse.ArgumentParser(prog="python -m inference_api", description=DESCRIPTION)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: %(default)s)")
    parser.add_argument(
        "--port", type=int, default=8000, help="port, 0 for a free one (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    # One BLAS thread; two on two busy cores are an order of magnitude slower.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    if os.environ.get("MLFLOW_TRACKING_URI"):
        # Not above, for it brings MLflow with it, and an API without a registry does without.
        from services.registry.mlflow_health import lower_patience  # noqa: PLC0415

        lower_patience(os.environ)
        os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
    try:
        family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
        listener = socket.create_server((options.host, options.port), family=family)
    except (OSError, OverflowError) as error:
        print(
            f"cannot listen on {options.host}:{options.port}: {error}; choose another --port", file=sys.stderr
        )
        return 1
    host, port = listener.getsockname()[:2]
    print(f"serving on http://{host}:{port} (documentation at http://{host}:{port}/docs)", flush=True)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s:     %(message)s")
    logging.getLogger("inference_api").setLevel(logging.INFO)
    for number in (signal.SIGINT, signal.SIGTERM):
        # The server shuts down, then raises the signal again; without this that would look like a crash.
        signal.signal(number, lambda *_: sys.exit(0))
    config = uvicorn.Config(
        "inference_api.app:create_app",
        factory=True,
        timeout_keep_alive=60,
        timeout_graceful_shutdown=10,
    )
    server = uvicorn.Server(config)
    server.run(sockets=[listener])
    return 0 if server.started else 1


if __name__ == "__main__":
    sys.exit(main())
