"""Serve a page that shows an arm among obstacles in 3D, with the API's samples and plans."""

import argparse
import contextlib
import io
import sys
import threading
from collections.abc import Callable, Sequence

import httpx

from cspace.errors import CspaceError, InputError
from cspace.world import World
from cspace.worlds import read_world
from cspace_client import ClientError, SamplingClient
from services.planner.client import usual_api
from services.planner.viewer.access import open_server
from services.planner.viewer.panels import PlanPanel, ScenePanel, as_text
from services.planner.viewer.state import SceneState

# The camera looks here, m in the base frame.
FOCUS_M = (0.45, 0.0, 0.35)


class Viewer:
    """Shows a planning problem, and changes it; ``address`` opens the page."""

    def __init__(self, api: SamplingClient, model: str, host: str, port: int) -> None:
        self.api, self.lock = api, threading.RLock()
        # Before a port is taken: whoever names a wrong model gets an error and no page.
        self.state = SceneState(api, world_of(api.url, model), model)
        self.server, self.address = open_server(host, port, label="cspace-sampler", verbose=False)
        self.server.initial_camera.position = (1.6, -1.3, 1.3)
        self.server.initial_camera.look_at = FOCUS_M
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/ground", 2.0, 2.0, cell_size=0.1, section_size=0.5)
        self.server.gui.add_html(as_text(f"Model: {model}"))
        self.scene, self.plan = ScenePanel(self), PlanPanel(self)
        self.guarded(self.scene.show)

    def guarded(self, action: Callable[[], None]) -> None:
        """Runs one action at a time, with what it sets off; an error is shown where the user looks."""
        with self.lock:
            try:
                action()
            except (CspaceError, ClientError, httpx.HTTPError) as error:
                self.scene.message.content = as_text(f"{type(error).__name__}: {error}")


def world_of(api_url: str, model: str) -> World:
    """The world of a model, as ``GET /models`` describes it; a bare name means its champion."""
    name, _, alias = model.partition("@")
    answer = httpx.get(f"{api_url}/models", params={"name": name.partition("/")[0]}, timeout=30.0)
    for one in answer.raise_for_status().json()["models"]:
        is_meant = one["name"] == name and (alias or "champion") in one["aliases"]
        if (is_meant or one["reference"] == model) and (one["world"] or {}).get("kind") == "spatial":
            return read_world(one["world"])
    expected = f"a model of an arm in space among those of {api_url}/models"
    raise InputError(f"the viewer cannot show the model {model}", expected=expected)


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
