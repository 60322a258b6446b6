"""``python -m services.planner.viewer``: an arm among obstacles in 3D, with the API's samples and plans.

The scene is drawn with viser. Obstacles and depth cameras can be dragged; the depth pictures are rendered
again, and the API is asked for samples and plans as any client would ask. Boxes that no camera sees can be
made known, and the arm can hold one. A view file or a recording that is dropped on the page takes the scene's
place.
"""

import argparse
import json
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import httpx
import numpy as np
import trimesh
import viser
import viser.transforms as vtf
from numpy.typing import NDArray

from cspace.errors import CspaceError, InputError
from cspace.planning.paths import spread_points
from cspace.simulator import UNIFORM, Checker, Problem, ProblemRequest, Split
from cspace.world import World
from cspace.worlds import partly_seen, read_world, simulator_of
from cspace.worlds.spatial.obstacles import Box
from cspace.worlds.spatial.planning_scene import read_planning_scene
from cspace.worlds.spatial.poses import HERE, make_pose, pose_of
from cspace.worlds.spatial.situation import Situation
from cspace_client import (
    ClientError,
    DepthPictures,
    FoundPlan,
    Known,
    PlanQuery,
    SamplingClient,
)
from services.planner.client import usual_api

Floats = NDArray[np.float64]
GREY, START, GOAL, ALONG = (150, 150, 155), (70, 120, 200), (60, 160, 90), (230, 150, 40)
UNSEEN, KNOWN, CONTACT, EXPECTED = (200, 190, 230), (90, 130, 190), (220, 30, 30), (120, 60, 200)
# A cell in which the model expects something at least as surely is shown.
BELIEVED = 0.5
# From here on the novelty is shown as a warning.
NOVEL, WARNING = 0.95, ' style="color:#c22"'
# What the shares mean, shown where the pointer rests.
MEANINGS = {
    "confidence of the samples": "how likely the model takes a sample to be collision-free, on average",
    "collision-free in the true scene": "share of the samples that are, by the scene's own obstacles",
    "of the arm in unknown space": "how much of the arm lies where no camera saw anything, on average",
    "novelty of the pictures": "share of the training pictures that are more usual than these; "
    f"from {NOVEL:.0%} on, trust the answer less",
}
# Around this point further cameras are placed, m in the base frame.
FOCUS_M = np.array([0.45, 0.0, 0.35])
ASIDE_RAD = (0.0, 1.3, -1.3)
CHECK_RAD, FRAMES, POINTS_AT_MOST = 0.005, 200, 8000
SAMPLES_AT_MOST = 200
SOURCE = "MotionBenchMaker"
# By the shipped model: a collision-free plan, and a refused one.
EXAMPLES = {"table-top": ("table", 4), "hard bin": ("bin", 17)}
RECORDINGS = (".mcap", ".db3")
IMPORT_S, LOAD_S = 120, 60.0
# viser takes files by a button alone: what is dropped is given to the button's field.
DROP_ZONE = """
<div style="margin:0 0.5em;padding:1em;border:2px dashed #999;border-radius:4px;text-align:center"
     ondragover="event.preventDefault()"
     ondrop="event.preventDefault();
             const field = document.querySelector('input[type=file]');
             field.files = event.dataTransfer.files;
             field.dispatchEvent(new Event('change', {bubbles: true}))">
  Drop a view file or a recording of ROS 2 here
</div>
"""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples for a scene.

    Args:
        rows: (n, d) rad.
        confidence: (n,) that each is collision-free, by the model.
        free: (n,) whether each is, by the scene's own obstacles; None where nobody knows these.
        novelty: of the pictures, 0 to 1; None where the model does not estimate it.
        unseen: mean share of the arm outside of what the cameras see; None where the API does not tell.
    """

    rows: Floats
    confidence: NDArray[np.float32]
    free: NDArray[np.bool_] | None
    novelty: float | None
    unseen: float | None


class SceneState:
    """A planning problem that a person changes, and what the API answers about it.

    Args:
        api: that is asked.
        world: arm and sensor of the model.
        model: that answers.
    """

    def __init__(self, api: SamplingClient, world: World, model: str) -> None:
        self.api, self.world, self.model = api, world, model
        self.simulator, self.benchmark = simulator_of(world), partly_seen(world)
        self.opened: Any = None
        self.boxes: tuple[Box, ...] = ()
        self.hold(None)
        self.problem = self.draw(*EXAMPLES["table-top"])

    @property
    def families(self) -> tuple[str, ...]:
        """Names of scene families, and of the sets of MotionBenchMaker for the robot that has them."""
        families = [name for name in self.simulator.families.names if name != UNIFORM]
        return (*families, *self.benchmark.sources.get(SOURCE, ()))

    @property
    def scene(self) -> Any:
        """Obstacles, cameras, the arm's state and the arm with what it holds."""
        return replace(cast("Any", self.problem.scenario), holding=self.arm)

    @property
    def view(self) -> Any:
        """What depth cameras saw: of the opened file, or of the scene."""
        return self.scene.view() if self.opened is None else self.opened

    def open(self, data: bytes) -> None:
        """Take a view file in the scene's place; the arm starts where it was.

        Raises:
            ImageError: it is none, or does not fit the arm.
        """
        self.opened = cast("Any", self.world).view(data)
        known = [state for state in self.opened.states if state is not None]
        if known:
            self.problem = replace(self.problem, start=np.asarray(known[-1]))

    def draw(self, family: str, seed: int) -> Problem:
        """Take the problem of a family and a seed: of the split ``demo``, or a shipped one of a set.

        Raises:
            InputError: an end of the set's problem collides, or lies outside the limits of the model's arm.
        """
        self.opened = None
        if family in self.simulator.families.names:
            self.problem = self.simulator.problem(family, Split.DEMO, seed)
            return self.problem
        index = seed % (self.benchmark.count(family, Split.VALIDATION) or 1)
        found = self.benchmark.problem(ProblemRequest(Split.VALIDATION), family, index, 1)
        if found is None or not self.world.space.contains([found.start, found.goal]).all():
            raise InputError(
                f"problem {index} of {family} does not fit the model's arm",
                expected="collision-free ends within its joint limits",
                remedy="take another seed",
            )
        scene: Any = found.scenario
        self.problem = replace(found, scenario=replace(scene, world=self.world))
        return self.problem

    @property
    def known(self) -> Known:
        """Boxes that no camera sees, and what the arm holds, as the API takes them."""
        scene = [{"name": f"box {at}", **_body(box)} for at, box in enumerate(self.boxes)]
        return Known(scene, [] if self.held is None else [{"name": "held", **_body(self.held)}])

    def hold(self, box: Box | None) -> None:
        """Attach a box, whose pose is in the tool's frame, to the arm, or nothing."""
        self.held, self.arm = box, cast("Any", self.world).body
        if box is not None:
            known = read_planning_scene(json.dumps(self.known.fields).encode())
            self.arm = Situation(self.arm, known).arm

    def checker(self) -> Checker:
        """Of the scene's own obstacles and the known boxes."""
        obstacles = replace(self.scene.obstacles, boxes=(*self.scene.obstacles.boxes, *self.boxes))
        return self.simulator.checker(replace(self.scene, obstacles=obstacles))

    def change(self, **parts: Any) -> None:
        """Replace ``obstacles``, ``cameras`` or ``state`` of the scene."""
        self.problem = replace(self.problem, scenario=replace(self.scene, **parts))

    def set_end(self, name: str, configuration: Sequence[float]) -> None:
        """Set ``start`` or ``goal``, rad; the arm stands at the start while it is pictured."""
        ends: dict[str, Any] = {name: np.asarray(configuration)}
        self.problem = replace(self.problem, **ends)
        if name == "start":
            self.change(state=tuple(configuration))

    def use_cameras(self, count: int) -> None:
        """Keep the first cameras, or add some about the scene."""
        cameras = list(self.scene.cameras[:count])
        for angle in ASIDE_RAD[len(cameras) : count]:
            cameras.append(replace(cameras[0], pose=_turned(np.asarray(cameras[0].pose), angle)))
        self.change(cameras=tuple(cameras))

    def pictures(self) -> DepthPictures:
        """What the cameras see, as the API takes it."""
        view, fields = self.view, ("fx", "fy", "cx", "cy", "pose")
        cameras = [{name: one.to_dict()[name] for name in fields} for one in view.cameras]
        return DepthPictures(view.pictures, cameras, view.state, known=self.known)

    def points_m(self) -> Floats:
        """What the cameras read, (N, 3) m in the base frame, thinned out."""
        view = self.view
        clouds = [
            camera.points_m(depth / 1000.0).reshape(-1, 3)[(depth > 0).reshape(-1)]
            for camera, depth in zip(view.cameras, view.pictures, strict=True)
        ]
        return _thinned(np.concatenate(clouds))

    def unseen_m(self) -> Floats:
        """What no camera sees of the space in reach, (N, 3) m in the base frame, thinned out."""
        return _thinned(cast("Any", self.world).unseen_m(self.view))

    def believed(self) -> tuple[Floats, NDArray[np.float32], float]:
        """Middles (N, 3) m of cells in which something is expected, how surely (N,), and a cell's side."""
        found = self.api.belief(self.pictures(), self.model)
        return found.centres_m(BELIEVED), found.cells[found.cells >= BELIEVED], found.cell_m

    def findings(self) -> str:
        """What the doctor says of the pictures, as Markdown."""
        found = self.api.doctor(self.pictures(), self.model)
        lines = [
            f"- **{one.code}**: {one.seen}; {one.effect}. Remedy: {one.remedy}." for one in found.verdicts
        ]
        lines += [
            f"- picture {pose.picture}: a pose {100 * pose.offset_m:.1f} cm and {pose.turn_deg:.1f} degrees "
            "away fits better"
            for pose in found.poses
        ]
        notes = [f"- {note}" for note in found.notes]
        return "\n".join([*(lines or ["No problems found."]), "", *notes])

    def sample(self, count: int, seed: int = 0) -> Samples:
        """Unfiltered samples with their confidence and the scene's own verdict."""
        shown = self.pictures()
        batch = self.api.sample(shown, count, seed, model=self.model, min_confidence=0.0)
        rows = np.asarray(batch.samples, dtype=np.float64)
        scored = self.api.validity(shown, rows, self.model)
        unseen = None if scored.unseen is None else float(np.mean(scored.unseen))
        free = None if self.opened is not None else self.checker().valid_batch(rows)
        return Samples(rows, scored.confidence, free, batch.novelty, unseen)

    def plan(self, min_confidence: float, seed: int = 0) -> tuple[FoundPlan, str]:
        """A plan from start to goal, and what the scene's own obstacles say of it."""
        ends = self.problem.start.tolist(), self.problem.goal.tolist()
        query = PlanQuery(start=ends[0], goal=ends[1], seed=seed, min_confidence=min_confidence, explain=True)
        found = self.api.plan(self.pictures(), query, self.model)
        path = found.path
        if len(path) < 2:
            return found, f"**{found.status}**: {found.reason}"
        if self.opened is not None:
            return found, f"Confidence {found.confidence:.0%}. The true scene is unknown."
        hits = int(self.blocked(path).sum())
        truth = "collision-free" if hits == 0 else f"**in collision** on {hits} of {len(path) - 1} edges"
        return found, f"Confidence {found.confidence:.0%}. In the true scene the path is {truth}."

    def blocked(self, path: Floats) -> NDArray[np.bool_]:
        """Which edges (M - 1,) of a path (M, d) collide in the true scene; none where nobody knows it."""
        if self.opened is not None:
            return np.zeros(len(path) - 1, dtype=np.bool_)
        return ~self.checker().edge_batch(path[:-1], path[1:], CHECK_RAD)


def _body(box: Box) -> dict[str, Any]:
    return {"box": {"size_m": [2.0 * half for half in box.half_m]}, "pose": box.pose}


def _table(shares: Mapping[str, float]) -> str:
    """Shares with their meanings as HTML; a high novelty is red."""
    rows = [
        f'<tr title="{MEANINGS[name]}"><td>{name}</td>'
        f"<td{WARNING if name.startswith('novelty') and value >= NOVEL else ''}>{value:.0%}</td></tr>"
        for name, value in shares.items()
    ]
    return f'<table style="margin:0 0.5em;font-size:0.85em;border-spacing:0.5em 0">{"".join(rows)}</table>'


def _thinned(points: Floats) -> Floats:
    """At most twice as many points (N, 3) as are shown."""
    return points[:: max(1, len(points) // POINTS_AT_MOST)]


def views_of_recording(name: str, content: bytes, world: World, base: str) -> list[bytes]:
    """View files of a recording, imported as the command line does.

    Args:
        name: of the file.
        content: its bytes.
        world: of the arm.
        base: tf frame of the arm's base.

    Raises:
        InputError: it is none, or nothing in it fits.
    """
    with TemporaryDirectory() as folder:
        source, arm, into = Path(folder) / Path(name).name, Path(folder) / "arm.json", Path(folder) / "views"
        source.write_bytes(content)
        arm.write_text(json.dumps(world.body.to_dict()))
        command = [sys.executable, "-m", "training.data", "import-recording", str(source), str(into)]
        command += [f"--arm={arm}", f"--base={base}", f"--time-limit={IMPORT_S}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise InputError(
                f"{name} cannot be imported",
                expected="a recording of ROS 2 with depth images, cameras, joint states and transforms",
                got=done.stderr.strip()[-400:],
                remedy="see python -m training.data import-recording --help for topics and frames",
            )
        return [path.read_bytes() for path in sorted((into / "views").iterdir())]


def _placed(pose: Any) -> dict[str, Any]:
    """A pose (4, 4) as viser takes it."""
    frame = vtf.SE3.from_matrix(np.asarray(pose))
    return {"wxyz": frame.rotation().wxyz, "position": frame.translation()}


def _moved(shapes: Sequence[Any], at: int, pose: Any) -> tuple[Any, ...]:
    """The same boxes, cylinders or cameras, one of them at another pose (4, 4)."""
    return tuple(replace(shape, pose=pose) if at == one else shape for one, shape in enumerate(shapes))


def _turned(pose: Floats, angle_rad: float) -> Floats:
    """A pose (4, 4) turned about the vertical through the focus."""
    focus = vtf.SE3.from_translation(FOCUS_M)
    turn = vtf.SE3.from_rotation(vtf.SO3.from_z_radians(angle_rad))
    return np.asarray((focus @ turn @ focus.inverse()).as_matrix() @ pose)


class Viewer:
    """The page: a viser server that shows a :class:`SceneState` and changes it."""

    def __init__(self, api: SamplingClient, model: str, host: str, port: int) -> None:
        self.api = api
        # Before a port is taken: whoever names a wrong model gets an error and no page.
        state = SceneState(api, world_of(api.url, model), model)
        self.ball = trimesh.creation.icosphere(subdivisions=1)
        self.server = viser.ViserServer(host, port, label="cspace-sampler", verbose=False)
        self.server.initial_camera.position = (1.6, -1.3, 1.3)
        self.server.initial_camera.look_at = tuple(FOCUS_M)
        self.lock = threading.RLock()
        self.show(state)
        # What was registered since.
        self.server.on_client_connect(lambda _: self._list_models())

    def show(self, state: SceneState) -> None:
        """Show a model's arm in a scene of its own, in place of all that is shown."""
        self.state, self.space = state, state.world.space
        self.path = np.empty((0, self.space.dim))
        self.views: list[bytes] = []
        self.server.gui.reset()
        self.server.scene.reset()
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/ground", 2.0, 2.0, cell_size=0.1, section_size=0.5)
        self._add_controls()
        self._add_known()
        self.show_scene()

    def _list_models(self) -> None:
        with suppress(httpx.HTTPError):
            self.model.options = models_of_arms(self.api.url, self.state.model)

    def _choose(self) -> None:
        wanted = self.model.value
        if wanted != self.state.model:
            self.message.content = f"Loading {wanted} ..."
            # Until it is there, and for good where it cannot be shown.
            self.model.value = self.state.model
            self.show(SceneState(self.api, world_of(self.api.url, wanted), wanted))

    def _add_controls(self) -> None:
        gui, state = self.server.gui, self.state
        models = models_of_arms(self.api.url, state.model)
        self.model: Any = gui.add_dropdown("model", models, initial_value=state.model)
        self.model.on_update(lambda _: self._guarded(self._choose))
        with gui.add_folder("Scene"):
            example = gui.add_button_group("examples", tuple(EXAMPLES))
            family, seed = EXAMPLES["table-top"]
            self.family: Any = gui.add_dropdown("family", state.families, initial_value=family)
            self.seed: Any = gui.add_number("seed", seed, min=0, step=1)
            self.cameras: Any = gui.add_slider("cameras", 1, len(ASIDE_RAD), 1, len(state.scene.cameras))
            self.count = gui.add_slider("samples", 1, SAMPLES_AT_MOST, 1, 60)
            self.shares = gui.add_html("")
            self.message = gui.add_markdown("")
            gui.add_markdown("Click an obstacle or a camera to move it.")
            self.unseen: Any = gui.add_checkbox("show unknown space", initial_value=False)
            self.believed: Any = gui.add_checkbox("show what the model expects", initial_value=False)
        self._add_upload()
        with gui.add_folder("Plan"):
            self.least = gui.add_slider("min. confidence", 0.0, 1.0, 0.01, 0.5)
            plan = gui.add_button("Plan a path", color="green")
            self.along = gui.add_slider("along the path", 0.0, 1.0, 1.0 / FRAMES, 0.0, disabled=True)
            self.verdict = gui.add_markdown("No path yet.")
        self.sliders: dict[str, list[Any]] = {name: self._joint_sliders(name) for name in ("start", "goal")}
        example.on_click(lambda event: self._guarded(partial(self._show_example, event.target.value)))
        for handle in (self.family, self.seed):
            # Without a client it is an example that was chosen.
            handle.on_update(lambda event: self._guarded(self._draw) if event.client_id is not None else None)
        self.cameras.on_update(lambda _: self._guarded(self._use_cameras))
        self.count.on_update(lambda _: self._guarded(self.show_samples))
        self.unseen.on_update(lambda _: self._guarded(self._show_unseen))
        self.believed.on_update(lambda _: self._guarded(self._show_believed))
        plan.on_click(lambda _: self._guarded(self.show_plan))
        self.along.on_update(lambda _: self._show_along())

    def _add_upload(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Your own pictures"):
            gui.add_html(DROP_ZONE)
            upload = gui.add_upload_button("Open a file")
            self.base = gui.add_text("base frame", "base_link")
            self.which: Any = gui.add_slider("view of the recording", 0, 1, 1, 0, visible=False)
            self.doctor = gui.add_markdown("")
        upload.on_upload(lambda _: self._guarded(partial(self._open, upload)))
        self.which.on_update(lambda _: self._guarded(self._show_opened))

    def _add_known(self) -> None:
        gui = self.server.gui
        with gui.add_folder("Known beside the pictures", expand_by_default=False):
            self.size_m: Any = gui.add_vector3(
                "size, m", (0.1, 0.1, 0.1), min=(0.01,) * 3, max=(1.0,) * 3, step=0.01
            )
            known = gui.add_button_group("a box", ("add", "hold", "forget"))
        known.on_click(lambda event: self._guarded(partial(self._know, event.target.value)))

    def _joint_sliders(self, name: str) -> list[Any]:
        values = getattr(self.state.problem, name)
        with self.server.gui.add_folder(f"{name.capitalize()}, rad", expand_by_default=False):
            sliders = [
                self.server.gui.add_slider(f"{name} joint {at + 1}", low, high, 0.01, float(value))
                for at, (low, high, value) in enumerate(
                    zip(self.space.lower, self.space.upper, values, strict=True)
                )
            ]

        def moved(event: viser.GuiEvent[Any]) -> None:
            # Without a client it is this program that moved it.
            if event.client_id is not None:
                self._guarded(self._set_ends)

        for slider in sliders:
            slider.on_update(moved)
        return sliders

    def _guarded(self, action: Callable[[], None]) -> None:
        """Run one action at a time, with what it sets off; an error is shown where the user looks."""
        with self.lock:
            try:
                action()
            except (CspaceError, ClientError, httpx.HTTPError) as error:
                self.message.content = f"**{type(error).__name__}**: {error}"

    def _show_example(self, name: str) -> None:
        self.family.value, self.seed.value = EXAMPLES[name]
        self._draw()

    def _draw(self) -> None:
        self.state.draw(self.family.value, int(self.seed.value))
        self.cameras.value = len(self.state.scene.cameras)
        self.views, self.which.visible, self.doctor.content = [], False, ""
        self.cameras.disabled = False
        self._show_ends()
        self.show_scene()

    def _know(self, what: str) -> None:
        half: Any = tuple(size / 2.0 for size in self.size_m.value)
        if what == "add":
            self.state.boxes += (Box(pose_of(make_pose(np.eye(3), FOCUS_M)), half),)
        elif what == "hold":
            self.state.hold(Box(HERE, half))
        else:
            self.state.boxes = ()
            self.state.hold(None)
        self.show_scene()

    def _show_ends(self) -> None:
        for name, sliders in self.sliders.items():
            for slider, value in zip(sliders, getattr(self.state.problem, name), strict=True):
                slider.value = float(value)

    def _open(self, upload: Any) -> None:
        """Show a view file, or the first view of a recording."""
        file, world = upload.value, self.state.world
        recorded = file.name.endswith(RECORDINGS)
        self.doctor.content = f"Reading {file.name} ..."
        try:
            self.views = (
                views_of_recording(file.name, file.content, world, self.base.value)
                if recorded
                else [file.content]
            )
            self.which.value = 0
            self.which.max, self.which.visible = max(1, len(self.views) - 1), len(self.views) > 1
            self._show_opened()
        except (CspaceError, ClientError) as error:
            self.doctor.content = f"**{type(error).__name__}**: {error}"

    def _show_opened(self) -> None:
        if not self.views:
            return
        self.state.open(self.views[int(self.which.value)])
        self.cameras.disabled = self.unseen.value = True
        self._show_ends()
        # First what needs no answer of the API, for that may fail.
        self.show_scene()
        self.doctor.content = self.state.findings()

    def _use_cameras(self) -> None:
        if self.cameras.value != len(self.state.scene.cameras):
            self.state.use_cameras(int(self.cameras.value))
            self.show_scene()

    def _set_ends(self) -> None:
        for name, sliders in self.sliders.items():
            self.state.set_end(name, [float(slider.value) for slider in sliders])
        self.show_scene()

    def show_scene(self) -> None:
        """Draw obstacles, cameras and both ends again, then ask for samples."""
        scene = self.server.scene
        with suppress(KeyError):
            scene.remove_by_name("/scene")
        self._forget_path()
        if self.state.opened is None:
            self._show_obstacles()
        for at, box in enumerate(self.state.boxes):
            shape = scene.add_box(
                f"/scene/known {at}", KNOWN, 2.0 * np.asarray(box.half_m), opacity=0.6, **_placed(box.pose)
            )
            self._movable(shape, partial(self._move_known, at))
        for at, camera in enumerate(self.state.view.cameras):
            field, aspect = 2.0 * np.arctan2(camera.height / 2.0, camera.fy), camera.width / camera.height
            frustum = scene.add_camera_frustum(
                f"/scene/camera {at}", float(field), aspect, scale=0.12, **_placed(camera.pose)
            )
            if self.state.opened is None:
                self._movable(frustum, partial(self._move_camera, at))
        self.show_samples()

    def _show_obstacles(self) -> None:
        scene = self.server.scene
        for at, box in enumerate(self.state.scene.obstacles.boxes):
            shape = scene.add_box(f"/scene/box {at}", GREY, 2.0 * np.asarray(box.half_m), **_placed(box.pose))
            self._movable(shape, partial(self._move, "boxes", at))
        for at, one in enumerate(self.state.scene.obstacles.cylinders):
            height = 2.0 * one.half_length_m
            round_ = scene.add_cylinder(
                f"/scene/cylinder {at}", one.radius_m, height, GREY, **_placed(one.pose)
            )
            self._movable(round_, partial(self._move, "cylinders", at))

    def _movable(self, shape: Any, moved: Callable[[Floats], None]) -> None:
        """A click on a shape shows the handles that it is dragged and turned by."""

        def drag(event: viser.TransformControlsEvent) -> None:
            handle = event.target
            shape.position, shape.wxyz = handle.position, handle.wxyz
            if event.phase == "end":
                rotation = vtf.SO3(np.asarray(handle.wxyz, dtype=np.float64))
                pose = vtf.SE3.from_rotation_and_translation(rotation, np.asarray(handle.position))
                self._guarded(partial(self._put, moved, pose.as_matrix().astype(np.float64)))

        def select(_: object) -> None:
            handle = self.server.scene.add_transform_controls(
                "/scene/handle", 0.25, wxyz=shape.wxyz, position=shape.position
            )
            handle.on_update(drag)

        shape.on_click(select)

    def _put(self, moved: Callable[[Floats], None], pose: Floats) -> None:
        moved(pose)
        self._forget_path()
        self.show_samples()

    def _move(self, kind: str, at: int, pose: Floats) -> None:
        obstacles = self.state.scene.obstacles
        shapes = _moved(getattr(obstacles, kind), at, pose)
        self.state.change(obstacles=replace(obstacles, **{kind: shapes}))

    def _move_known(self, at: int, pose: Floats) -> None:
        self.state.boxes = _moved(self.state.boxes, at, pose.tolist())

    def _move_camera(self, at: int, pose: Floats) -> None:
        self.state.change(cameras=_moved(self.state.scene.cameras, at, pose))

    def show_samples(self) -> None:
        """Draw what the cameras read, and samples coloured by confidence."""
        scene, problem = self.server.scene, self.state.problem
        self._show_arm("/scene/start", problem.start, START, 1.0)
        self._show_arm("/scene/goal", problem.goal, GOAL, 0.4)
        cloud = self.state.points_m()
        scene.add_point_cloud("/scene/cloud", cloud, (40, 40, 40), point_size=0.004)
        self._show_unseen()
        # An API that fails leaves no figures of another scene.
        self.shares.content = ""
        found = self.state.sample(int(self.count.value))
        joints = self.state.arm.joint_positions_m(found.rows)
        segments = np.stack([joints[:, :-1], joints[:, 1:]], axis=2)
        confidence = np.asarray(found.confidence)[:, None, None, None]
        colours = np.array([200, 40, 40]) * (1.0 - confidence) + np.array([40, 170, 80]) * confidence
        scene.add_line_segments(
            "/scene/samples",
            segments.reshape(-1, 2, 3),
            np.broadcast_to(colours, segments.shape).reshape(-1, 2, 3).astype(np.uint8),
            thickness=0.004,
        )
        shares = {
            "confidence of the samples": float(np.mean(found.confidence)),
            "collision-free in the true scene": None if found.free is None else float(np.mean(found.free)),
            "of the arm in unknown space": found.unseen,
            "novelty of the pictures": found.novelty,
        }
        self.shares.content = _table({name: value for name, value in shares.items() if value is not None})
        self.message.content = ""
        # Last, for not every model can tell.
        self._show_believed()

    def _show_unseen(self) -> None:
        points = self.state.unseen_m() if self.unseen.value else np.empty((0, 3))
        self.server.scene.add_point_cloud("/scene/unseen", points, UNSEEN, point_size=0.004)

    def _show_believed(self) -> None:
        """Translucent cells, the surer the less so."""
        with suppress(KeyError):
            self.server.scene.remove_by_name("/scene/believed")
        if not self.believed.value:
            return
        centres, surely, cell_m = self.state.believed()
        self._show_copies(
            "/scene/believed",
            trimesh.creation.box((cell_m,) * 3),
            centres,
            batched_colors=EXPECTED,
            batched_opacities=(0.5 * surely).astype(np.float32),
            cast_shadow=False,
            receive_shadow=False,
            flat_shading=True,
        )

    def show_plan(self) -> None:
        """Ask for a path, check it in the true scene, and draw it."""
        self._forget_path()
        found, self.verdict.content = self.state.plan(float(self.least.value))
        if found.contact is not None:
            place = np.array(found.contact.position_m)
            self.server.scene.add_icosphere("/path/contact", 0.03, CONTACT, position=place)
        if len(found.path) < 2:
            return
        self.path = spread_points(found.path, FRAMES + 1, self.space)
        hand = self.state.arm.joint_positions_m(self.path)[:, -1]
        segments = np.stack([hand[:-1], hand[1:]], axis=1)
        blocked = self.state.blocked(self.path)
        colours = np.where(blocked[:, None, None], CONTACT, ALONG).astype(np.uint8)
        self.server.scene.add_line_segments(
            "/path/hand", segments, np.broadcast_to(colours, segments.shape), thickness=0.008
        )
        self.along.disabled = False
        self._show_along()

    def _forget_path(self) -> None:
        self.path, self.along.disabled, self.verdict.content = self.path[:0], True, "No path yet."
        with suppress(KeyError):
            self.server.scene.remove_by_name("/path")

    def _show_along(self) -> None:
        path = self.path
        if len(path):
            at = round(float(self.along.value) * (len(path) - 1))
            self._show_arm("/path/arm", path[at], ALONG, 1.0)

    def _show_arm(
        self, name: str, configuration: Floats, colour: tuple[int, int, int], opacity: float
    ) -> None:
        self._show_copies(
            name,
            self.ball,
            self.state.arm.sphere_centres_m(configuration[None])[0],
            batched_scales=self.state.arm.spheres_m()[:, 3].astype(np.float32),
            batched_colors=colour,
            opacity=None if opacity == 1.0 else opacity,
        )

    def _show_copies(self, name: str, mesh: trimesh.Trimesh, centres_m: Floats, **options: Any) -> None:
        """Draw a mesh around each of (N, 3) places, unturned."""
        self.server.scene.add_batched_meshes_simple(
            name,
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.uint32),
            np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(centres_m), 1)),
            centres_m.astype(np.float32),
            **options,
        )


def models_of_arms(api_url: str, shown: str) -> tuple[str, ...]:
    """References of models of arms in space, and of those that the API has not loaded; ``shown`` is one."""
    fitting = (one["reference"] for one in _listed(api_url) if _is_arm(one))
    return tuple(dict.fromkeys((shown, *fitting)))


def world_of(api_url: str, model: str) -> World:
    """The world of a model, as ``GET /models`` describes it once the API has loaded it.

    Raises:
        InputError: the API does not serve the model, or it is no arm among obstacles in space.
    """
    found = _entry(api_url, model)
    if found is not None and found["world"] is None:
        # What a request names is loaded before the request is looked at.
        httpx.post(f"{api_url}/doctor", json={"model": model, "image": ""}, timeout=LOAD_S)
        found = _entry(api_url, model)
    if found is None or not found["world"] or not _is_arm(found):
        fitting = [one["reference"] for one in _listed(api_url) if _is_arm(one)]
        raise InputError(
            f"the viewer cannot show the model {model}",
            expected=f"a model of an arm in space, such as {', '.join(fitting) or 'none that is served'}",
            got="no such model" if found is None else "one of another kind",
        )
    return read_world(found["world"])


def _entry(api_url: str, model: str) -> dict[str, Any] | None:
    """What is listed of a reference; a bare name means its champion."""
    name, _, alias = model.partition("@")
    listed = _listed(api_url, name.partition("/")[0])
    return next(
        (
            one
            for one in listed
            if one["reference"] == model or (one["name"] == name and (alias or "champion") in one["aliases"])
        ),
        None,
    )


def _is_arm(listed: dict[str, Any]) -> bool:
    """Whether a model is of an arm in space; of one that is not loaded nobody may know."""
    return listed["world"] is None or listed["world"]["kind"] == "spatial"


def _listed(api_url: str, name: str | None = None) -> list[dict[str, Any]]:
    answer = httpx.get(f"{api_url}/models", params={} if name is None else {"name": name}, timeout=30.0)
    return cast("list[dict[str, Any]]", answer.raise_for_status().json()["models"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve the page until the process is ended."""
    parser = argparse.ArgumentParser(prog="python -m services.planner.viewer", description=__doc__)
    parser.add_argument("--api", default=usual_api(), help="address of the API (default: %(default)s)")
    parser.add_argument("--model", default="pretrained-panda", help="that answers (default: %(default)s)")
    parser.add_argument("--host", default="127.0.0.1", help="where to listen (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8090, help="where to listen (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        with SamplingClient(options.api) as api:
            Viewer(api, options.model, options.host, options.port)
            sys.stdout.write(f"http://{options.host}:{options.port}/\n")
            sys.stdout.flush()
            threading.Event().wait()
    except (CspaceError, ClientError, httpx.HTTPError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
