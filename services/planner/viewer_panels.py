"""Panels of the page: the scene with samples by confidence, and the planned path."""

import html
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
import trimesh
import viser
import viser.transforms as vtf

from cspace.planning.paths import spread_points
from services.planner.viewer_state import EXAMPLES, Floats

GREY, START, GOAL = (150, 150, 155), (70, 120, 200), (60, 160, 90)
EXPECTED = (120, 60, 200)
LOW, HIGH = np.array([200, 40, 40]), np.array([40, 170, 80])
SAMPLES_AT_MOST = 200
NOVEL = 0.95
ALONG, COLLISION = (230, 150, 40), (220, 30, 30)
FRAMES = 200


def as_text(text: str) -> str:
    """HTML that shows a text as it is: names of models and errors come from others."""
    style = "margin:0 1em;font-size:0.85em;white-space:pre-wrap;overflow-wrap:anywhere"
    return f'<p style="{style}">{html.escape(text)}</p>'


def _placed(pose: Any) -> dict[str, Any]:
    """A pose (4, 4) as viser takes it."""
    frame = vtf.SE3.from_matrix(np.asarray(pose))
    return {"wxyz": frame.rotation().wxyz, "position": frame.translation()}


class ScenePanel:
    """Controls and drawing of the scene."""

    def __init__(self, viewer: Any) -> None:
        self.viewer, self.state, self.server = viewer, viewer.state, viewer.server
        gui, guarded = self.server.gui, viewer.guarded
        with gui.add_folder("Scene"):
            example = gui.add_button_group("examples", tuple(EXAMPLES))
            family, seed = EXAMPLES["table-top"]
            self.family: Any = gui.add_dropdown("family", self.state.families, initial_value=family)
            self.seed: Any = gui.add_number("seed", seed, min=0, step=1)
            self.count = gui.add_slider("samples", 1, SAMPLES_AT_MOST, 1, 60)
            self.shares = gui.add_html("")
            self.message = gui.add_html("")
            gui.add_html(as_text("Click an obstacle or a camera to move it."))
            self.expected: Any = gui.add_checkbox("show what the model expects", initial_value=False)
        self.sliders = {name: self._joint_sliders(name) for name in ("start", "goal")}
        self.expected.on_update(lambda _: guarded(self._show_expected))
        example.on_click(lambda event: guarded(partial(self._show_example, event.target.value)))
        for handle in (self.family, self.seed):
            handle.on_update(partial(self._by_hand, self._draw))
        self.count.on_update(lambda _: guarded(self.show_samples))

    def _joint_sliders(self, name: str) -> list[Any]:
        gui, space = self.server.gui, self.state.world.space
        with gui.add_folder(f"{name.capitalize()}, rad", expand_by_default=False):
            ends = zip(space.lower, space.upper, getattr(self.state.problem, name), strict=True)
            sliders = [
                gui.add_slider(f"{name} joint {at + 1}", low, high, 0.01, float(value))
                for at, (low, high, value) in enumerate(ends)
            ]
        for slider in sliders:
            slider.on_update(partial(self._by_hand, self._set_ends))
        return sliders

    def _by_hand(self, action: Callable[[], None], event: viser.GuiEvent[Any]) -> None:
        """Without a client it is this program that has set the value."""
        if event.client_id is not None:
            self.viewer.guarded(action)

    def _set_ends(self) -> None:
        for name, sliders in self.sliders.items():
            self.state.set_end(name, [float(slider.value) for slider in sliders])
        self.show()

    def show_ends(self) -> None:
        """Sets the sliders to start and goal."""
        for name, sliders in self.sliders.items():
            for slider, value in zip(sliders, getattr(self.state.problem, name), strict=True):
                slider.value = float(value)

    def _show_example(self, name: str) -> None:
        self.family.value, self.seed.value = EXAMPLES[name]
        self._draw()

    def _draw(self) -> None:
        self.state.draw(self.family.value, int(self.seed.value))
        self.show_ends()
        self.show()

    def show(self) -> None:
        """Draws obstacles, cameras and both ends again, then asks for samples."""
        scene, state = self.server.scene, self.state
        with suppress(KeyError):
            scene.remove_by_name("/scene")
        self.viewer.plan.forget()
        obstacles = state.scene.obstacles
        for at, box in enumerate(obstacles.boxes):
            size_m = 2.0 * np.asarray(box.half_m)
            self._movable(scene.add_box(f"/scene/box {at}", GREY, size_m, **_placed(box.pose)), "boxes", at)
        for at, one in enumerate(obstacles.cylinders):
            name, height_m = f"/scene/cylinder {at}", 2.0 * one.half_length_m
            round_ = scene.add_cylinder(name, one.radius_m, height_m, GREY, **_placed(one.pose))
            self._movable(round_, "cylinders", at)
        for at, camera in enumerate(state.scene.cameras):
            field, aspect = 2.0 * np.arctan2(camera.height / 2.0, camera.fy), camera.width / camera.height
            frustum = scene.add_camera_frustum(
                f"/scene/camera {at}", float(field), aspect, scale=0.12, **_placed(camera.pose)
            )
            self._movable(frustum, "cameras", at)
        self.show_samples()

    def _movable(self, shape: Any, kind: str, at: int) -> None:
        """A click on a shape shows the handles that it is dragged and turned by."""

        def drag(event: viser.TransformControlsEvent) -> None:
            handle = event.target
            shape.position, shape.wxyz = handle.position, handle.wxyz
            if event.phase == "end":
                turn = vtf.SO3(np.asarray(handle.wxyz, dtype=np.float64))
                pose = vtf.SE3.from_rotation_and_translation(turn, np.asarray(handle.position)).as_matrix()
                self.viewer.guarded(partial(self._put, kind, at, pose.astype(np.float64)))

        def select(_: object) -> None:
            place = {"wxyz": shape.wxyz, "position": shape.position}
            self.server.scene.add_transform_controls("/scene/handle", 0.25, **place).on_update(drag)

        shape.on_click(select)

    def _put(self, kind: str, at: int, pose: Floats) -> None:
        self.state.move(kind, at, pose)
        self.viewer.plan.forget()
        self.show_samples()

    def show_samples(self) -> None:
        """Draws what the cameras read, and samples coloured by confidence."""
        scene, state = self.server.scene, self.state
        self.show_arm("/scene/start", state.problem.start, START)
        self.show_arm("/scene/goal", state.problem.goal, GOAL, opacity=0.4)
        scene.add_point_cloud("/scene/cloud", state.points_m(), (40, 40, 40), point_size=0.004)
        # An API that fails leaves no figures of another scene.
        self.shares.content = ""
        found = state.sample(int(self.count.value))
        joints = state.arm.joint_positions_m(found.rows)
        segments = np.stack([joints[:, :-1], joints[:, 1:]], axis=2)
        confidence = np.asarray(found.confidence)[:, None, None, None]
        colours = np.broadcast_to(LOW * (1.0 - confidence) + HIGH * confidence, segments.shape)
        colours = colours.reshape(-1, 2, 3).astype(np.uint8)
        scene.add_line_segments("/scene/samples", segments.reshape(-1, 2, 3), colours, thickness=0.004)
        shares = {
            "confidence of the samples": float(np.mean(found.confidence)),
            "collision-free in the true scene": float(np.mean(found.free)),
            "of the arm in unknown space": found.unseen,
            "novelty of the pictures": found.novelty,
        }
        lines = [f"{value:.0%} {name}" for name, value in shares.items() if value is not None]
        if found.novelty is not None and found.novelty >= NOVEL:
            lines.append("The pictures are unlike those of the training: trust the answer less.")
        self.shares.content = as_text("\n".join(lines))
        self.message.content = ""
        # Last, for not every model can tell.
        self._show_expected()

    def _show_expected(self) -> None:
        """Translucent cells, the more probable the less so."""
        with suppress(KeyError):
            self.server.scene.remove_by_name("/scene/expected")
        if self.expected.value:
            centres, probability, cell_m = self.state.expected()
            opacities = (0.5 * probability).astype(np.float32)
            look: dict[str, Any] = {"batched_colors": EXPECTED, "batched_opacities": opacities}
            look |= {"cast_shadow": False, "receive_shadow": False, "flat_shading": True}
            self._show_copies("/scene/expected", trimesh.creation.box((cell_m,) * 3), centres, **look)

    def show_arm(
        self, name: str, configuration: Floats, colour: tuple[int, int, int], opacity: float | None = None
    ) -> None:
        """Draws the arm's spheres."""
        arm, ball = self.state.arm, trimesh.creation.icosphere(subdivisions=1)
        look = {"batched_scales": arm.spheres_m()[:, 3].astype(np.float32), "opacity": opacity}
        centres = arm.sphere_centres_m(configuration[None])[0]
        self._show_copies(name, ball, centres, batched_colors=colour, **look)

    def _show_copies(self, name: str, mesh: trimesh.Trimesh, centres_m: Floats, **look: Any) -> None:
        upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(centres_m), 1))
        vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)
        places = upright, centres_m.astype(np.float32)
        self.server.scene.add_batched_meshes_simple(name, vertices, faces, *places, **look)


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
