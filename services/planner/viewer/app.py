"""The page: a viser server that shows a model's arm in a scene."""

import threading
from collections.abc import Callable

import httpx

from cspace.errors import CspaceError, InputError
from cspace.world import World
from cspace.worlds import read_world
from cspace_client import ClientError, SamplingClient
from services.planner.viewer.access import Uploads, open_server
from services.planner.viewer.plan import PlanPanel
from services.planner.viewer.scene import ScenePanel, as_text
from services.planner.viewer.state import SceneState
from services.planner.viewer.uploads import REFUSED, UploadPanel

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
        self.scene, self.uploads, self.plan = ScenePanel(self), UploadPanel(self), PlanPanel(self)
        self.bounds = Uploads(self.server, lambda: self.uploads.say(REFUSED))
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
