"""Serve a page that shows an arm among obstacles in 3D, with the API's samples and plans."""

import argparse
import contextlib
import io
import sys
import threading
from collections.abc import Sequence

import httpx

from cspace.errors import CspaceError
from cspace_client import ClientError, SamplingClient
from services.planner.client import usual_api
from services.planner.viewer.app import Viewer


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, serve, print the address that holds the token."""
    parser = argparse.ArgumentParser("python -m services.planner.viewer", description=__doc__)
    parser.add_argument("--api", default=usual_api(), help="address of the API (default: %(default)s)")
    parser.add_argument("--model", default="pretrained-panda", help="that answers (default: %(default)s)")
    parser.add_argument("--host", default="127.0.0.1", help="default: %(default)s")
    parser.add_argument("--port", type=int, default=8090, help="where to listen (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        with SamplingClient(options.api) as api:
            with contextlib.redirect_stdout(io.StringIO()):  # viser prints its address without the token
                viewer = Viewer(api, options.model, options.host, options.port)
            print(viewer.address, flush=True)
            threading.Event().wait()
    except (CspaceError, ClientError, httpx.HTTPError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
