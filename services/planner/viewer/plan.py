"""Shows a planned path, and whether it is free in the true scene."""

from contextlib import suppress
from typing import Any

import numpy as np

from cspace.planning.paths import spread_points
from services.planner.viewer.scene import as_text

ALONG, COLLISION = (230, 150, 40), (220, 30, 30)
FRAMES = 200


class PlanPanel:
    """Controls and drawing of a path."""

    def __init__(self, viewer: Any) -> None:
        self.viewer, self.state, self.server = viewer, viewer.state, viewer.server
        gui = self.server.gui
        self.path = np.empty((0, self.state.world.space.dim))
        with gui.add_folder("Plan"):
            self.least = gui.add_slider("min. confidence", 0.0, 1.0, 0.01, 0.5)
            button = gui.add_button("Plan a path", color="green")
            self.along: Any = gui.add_slider("along the path", 0.0, 1.0, 1.0 / FRAMES, 0.0, disabled=True)
            self.verdict = gui.add_html(as_text("No path yet."))
        button.on_click(lambda _: viewer.guarded(self.show))
        self.along.on_update(lambda _: self._show_along())

    def forget(self) -> None:
        """Removes the path of another problem."""
        self.path, self.along.disabled = self.path[:0], True
        self.verdict.content = as_text("No path yet.")
        with suppress(KeyError):
            self.server.scene.remove_by_name("/path")

    def show(self) -> None:
        """Asks for a path, checks it in the true scene, and draws it."""
        self.forget()
        found, verdict = self.state.plan(float(self.least.value))
        self.verdict.content = as_text(verdict)
        if found.contact is not None:
            place = np.asarray(found.contact.position_m)
            self.server.scene.add_icosphere("/path/contact", 0.03, COLLISION, position=place)
        if len(found.path) < 2:
            return
        self.path = spread_points(np.asarray(found.path), FRAMES + 1, self.state.world.space)
        hand = self.state.arm.joint_positions_m(self.path)[:, -1]
        segments = np.stack([hand[:-1], hand[1:]], axis=1)
        blocked = self.state.blocked(self.path)[:, None, None]
        colours = np.broadcast_to(np.where(blocked, COLLISION, ALONG).astype(np.uint8), segments.shape)
        self.server.scene.add_line_segments("/path/hand", segments, colours, thickness=0.008)
        self.along.disabled = False
        self._show_along()

    def _show_along(self) -> None:
        if len(self.path):
            at = round(float(self.along.value) * (len(self.path) - 1))
            self.viewer.scene.show_arm("/path/arm", self.path[at], ALONG)
