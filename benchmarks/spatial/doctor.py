"""How many planted mistakes the doctor finds in depth views, and how often it sees one where there is none.

    python -m benchmarks.spatial.doctor [--views 1000] [--pose-errors 200] [--seed 1]

Views are simulated as for training, with the cameras' noise and without holes. Scenes are left out in which
something stands before a camera, so that even an exact picture shows none of the arm's reach. Half of the
views have one planted mistake, of ten kinds in turn, in one camera (units and states concern all). A mistake
counts as found by a finding that names it or what it does, see :data:`KINDS`, or by a refusal. Mistakes that
only the arm gives away are planted where at least :data:`IN_VIEW` of a picture's pixels show it. Pose errors
are of exactly 2 cm or 2 degrees, in any direction, likewise. Shares come with Wilson intervals of 95 %.

The arm is drawn as the spheres that the doctor compares with. ``--urdf`` draws it by its meshes instead,
which lie up to 2 cm below them (extra ``spatial``).
"""

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np
import trimesh
from scipy.stats import binomtest

from benchmarks.command import arguments
from benchmarks.machine import machine
from cspace.errors import ImageError, ScenarioError
from cspace.simulator import Split
from cspace.world import Diagnosis
from cspace.worlds import examples
from cspace.worlds.spatial.camera import DepthCamera, to_mm
from cspace.worlds.spatial.camera_info import OPTICAL_IN_BODY
from cspace.worlds.spatial.mesh_checker import Description, RobotMeshes
from cspace.worlds.spatial.poses import pose_of, turn
from cspace.worlds.spatial.rendering import MAX_RANGE_M, NOISE_MODELS, render_depth
from cspace.worlds.spatial.scenes import SpatialScene, draw_scene, waiting
from cspace.worlds.spatial.view import DepthView
from cspace.worlds.spatial.world import SpatialWorld

IN_VIEW = 0.01
# What is true of a view in which something stands before a camera.
BLOCKED = {"nothing-in-reach", "little-in-reach", "no-surface-in-reach"}
POSE = {"rolled", "looks-up", "extrinsics", "arm-elsewhere", "cameras-disagree", "nothing-in-reach",
        "no-surface-in-reach", "little-in-reach", "inverted-pose", "body-frame", "opengl-frame",
        "upside-down", "camera-inside-arm", "far-camera", "arm-pixels-left"}  # fmt: skip
UNIT = {"depth-unit", "out-of-range", "near-readings", "nothing-in-reach", "no-surface-in-reach"}
STATE = {"arm-in-picture", "arm-elsewhere", "arm-pixels-left", "extrinsics"}
NUMBERS = {"principal-point", "focal-lengths", "field-of-view", "extrinsics", "arm-elsewhere"}
Mistake = Callable[[np.random.Generator, SpatialScene, DepthView, int], DepthView]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of mistake.

    Args:
        plant: takes the view that is right and the number of a picture; raises ImageError for a refusal.
        finds: codes that name it.
        by_arm: whether only the arm in the picture gives it away.
    """

    plant: Mistake
    finds: set[str]
    by_arm: bool = False


def _posed(view: DepthView, number: int, pose: np.ndarray) -> DepthView:
    return _with_camera(view, number, replace(view.cameras[number], pose=pose_of(pose)))


def _with_camera(view: DepthView, number: int, camera: DepthCamera) -> DepthView:
    return replace(view, cameras=(*view.cameras[:number], camera, *view.cameras[number + 1 :]))


def _unit(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """Depths in tenths of mm, of TUM RGB-D, in cm, or in metres, all taken for mm."""
    del scene, number
    scale = float(rng.choice([10.0, 5.0, 0.1, 0.001]))
    pictures = [np.minimum(np.rint(one * scale), 65535).astype(np.uint16) for one in view.pictures]
    return replace(view, pictures=tuple(pictures))


def _inverted(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    del rng, scene
    return _posed(view, number, np.linalg.inv(view.cameras[number].matrix))


def _body(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """The pose of the camera's body for that of its optical frame."""
    del rng, scene
    return _posed(view, number, view.cameras[number].matrix @ np.linalg.inv(OPTICAL_IN_BODY))


def _upside_down(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """A pose of OpenGL, a picture that hangs head down, or a pose that does."""
    del scene
    axes = [(1.0, -1.0, -1.0, 1.0), (-1.0, -1.0, 1.0, 1.0), None][int(rng.integers(3))]
    if axes is not None:
        return _posed(view, number, view.cameras[number].matrix @ np.diag(axes))
    turned = np.ascontiguousarray(view.pictures[number][::-1, ::-1])
    return replace(view, pictures=(*view.pictures[:number], turned, *view.pictures[number + 1 :]))


def _inside(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """The place of a link, or of an obstacle, for that of the camera."""
    pose = view.cameras[number].matrix
    boxes = scene.obstacles.boxes
    state = view.states[number]
    if state is None or (boxes and rng.random() < 0.5):
        pose[:3, 3] = np.array(boxes[int(rng.integers(len(boxes)))].pose)[:3, 3]
    else:
        spheres = scene.world.body.spheres_at(state)
        pose[:3, 3] = spheres[int(rng.integers(len(spheres))), :3]
    return _posed(view, number, pose)


def _off(metres: tuple[float, float], degrees: tuple[float, float]) -> Mistake:
    def plant(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
        del scene
        pose = view.cameras[number].matrix
        path, axis = (one / np.linalg.norm(one) for one in rng.normal(size=(2, 3)))
        pose[:3, 3] += rng.uniform(*metres) * path
        pose[:3, :3] = turn(axis, np.radians(rng.uniform(*degrees))) @ pose[:3, :3]
        return _posed(view, number, pose)

    return plant


def _state(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """No state, or that of another moment."""
    del number
    other = waiting(rng, scene.world.body, scene.obstacles) if rng.random() < 0.5 else None
    return replace(view, state=None if other is None else tuple(other.tolist()))


def _numbers(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """Focal lengths and centre of another resolution."""
    del scene
    one, scale = view.cameras[number], float(rng.choice([0.5, 2.0, 5.0]))
    return _with_camera(
        view, number,
        replace(one, fx=one.fx * scale, fy=one.fy * scale, cx=one.cx * scale, cy=one.cy * scale),
    )  # fmt: skip


def _blank(rng: np.random.Generator, scene: SpatialScene, view: DepthView, number: int) -> DepthView:
    """A covered lens with some readings left, or no readings on the arm and about it."""
    picture = view.pictures[number].copy()
    if rng.random() < 0.5:
        picture[rng.random(picture.shape) > 0.02] = 0
    else:
        assert scene.state is not None  # noqa: S101 - by_arm
        spheres = scene.world.body.spheres_at(scene.state)
        picture[render_depth(scene.obstacles, view.cameras[number], spheres).robot] = 0
    return replace(view, pictures=(*view.pictures[:number], picture, *view.pictures[number + 1 :]))


KINDS = {
    "unit of depths": Kind(_unit, UNIT),
    "inverted pose": Kind(_inverted, POSE),
    "body frame": Kind(_body, POSE),
    "upside down": Kind(_upside_down, POSE),
    "camera inside": Kind(_inside, POSE),
    "moved by 2 to 10 cm": Kind(_off((0.02, 0.10), (0.0, 0.0)), POSE, by_arm=True),
    "turned by 2 to 10 degrees": Kind(_off((0.0, 0.0), (2.0, 10.0)), POSE, by_arm=True),
    "state": Kind(_state, STATE, by_arm=True),
    "numbers of another size": Kind(_numbers, NUMBERS),
    "blank": Kind(_blank, {"blank", "holes"}, by_arm=True),
}
EXACT = {
    "2 cm": Kind(_off((0.02, 0.02), (0.0, 0.0)), POSE, by_arm=True),
    "2 degrees": Kind(_off((0.0, 0.0), (2.0, 2.0)), POSE, by_arm=True),
}


def scenes(world: SpatialWorld, split: Split, seed: int) -> Iterator[SpatialScene]:
    """Scenes without end, seen without holes, in which no camera is blocked."""
    rng = np.random.default_rng(seed)
    for index in count():
        scene = replace(draw_scene(rng, world, split, index), holes=0.0)
        try:
            findings = world.examined(replace(scene, noise=None).view()).findings
        except ImageError:
            continue
        if not {one.code for one in findings} & BLOCKED:
            yield scene


class MeshArm:
    """An arm's surface as points, to draw it as it is instead of by the spheres that cover it.

    Args:
        world: whose arm it is.
        urdf: its description, with meshes.
    """

    # Of pictures, so that every pixel of the finer one is hit.
    FINER, A_SQUARE_METRE = 3, 1_200_000

    def __init__(self, world: SpatialWorld, urdf: Path) -> None:
        fingers = {f"panda_finger_joint{number}": 0.065 for number in (1, 2)}
        self._meshes = RobotMeshes(world.body, Description(urdf, fingers, convex=False))
        self._points: list[np.ndarray] = []
        for number, shape in enumerate(self._meshes.geometry.geometryObjects):
            if shape.meshPath == "BOX":
                mesh = trimesh.creation.box(extents=2.0 * np.asarray(shape.geometry.halfSide))
            else:
                mesh = trimesh.load(shape.meshPath, force="mesh")
                mesh.apply_scale(np.asarray(shape.meshScale))
            count = int(self.A_SQUARE_METRE * mesh.area) + 100
            self._points.append(np.asarray(trimesh.sample.sample_surface(mesh, count, seed=number)[0]))

    def view(self, scene: SpatialScene) -> DepthView:
        """What the cameras of a scene see, as :meth:`SpatialScene.view` without holes."""
        if scene.state is None:
            return scene.view()
        rng, points = np.random.default_rng(scene.noise_seed), self._placed(np.array(scene.state))
        pictures = []
        for camera in scene.cameras:
            depth = render_depth(scene.obstacles, camera).depth_m
            arm = self._rendered(camera, points)
            nearer = arm < np.where(depth > 0.0, depth, MAX_RANGE_M)
            exact = np.where(nearer, arm, depth).astype(np.float32)
            pictures.append(
                to_mm(exact if scene.noise is None else NOISE_MODELS[scene.noise](rng, exact, camera))
            )
        return DepthView(tuple(pictures), scene.cameras, scene.state)

    def _placed(self, state: np.ndarray) -> np.ndarray:
        places = self._meshes.places(state)
        return np.concatenate(
            [points @ pose[:3, :3].T + pose[:3, 3] for points, pose in zip(self._points, places, strict=True)]
        )

    def _rendered(self, camera: DepthCamera, points: np.ndarray) -> np.ndarray:
        fine = camera.resized(self.FINER * camera.width, self.FINER * camera.height)
        seen = fine.project(points)
        seen = seen[fine.shows(seen)]
        depth = np.full(fine.picture_shape, np.inf)
        columns, rows = np.rint(seen[:, :2]).astype(int).T
        np.minimum.at(depth, (rows, columns), seen[:, 2])
        cells = depth.reshape(camera.height, self.FINER, camera.width, self.FINER)
        full = np.isfinite(cells).sum(axis=(1, 3)) >= self.FINER
        middle = depth[1 :: self.FINER, 1 :: self.FINER]
        return np.where(np.isfinite(middle), middle, np.where(full, cells.min(axis=(1, 3)), np.inf))


def arm_shown(scene: SpatialScene) -> list[int]:
    """Numbers of the cameras that see enough of the arm."""
    if scene.state is None:
        return []
    spheres = scene.world.body.spheres_at(scene.state)
    return [
        number
        for number, camera in enumerate(scene.cameras)
        if render_depth(scene.obstacles, camera, spheres).robot.mean() >= IN_VIEW
    ]


def codes_of(world: SpatialWorld, view: DepthView) -> set[str]:
    """Codes of all that the doctor finds."""
    found: Diagnosis = world.diagnosed(view)
    return {one.code for one in found.findings}


def planted(rng: np.random.Generator, scene: SpatialScene, view: DepthView, kind: Kind) -> set[str] | None:
    """The codes found in a view with a mistake, of which ``refused`` is one; None where it has no room."""
    shown = arm_shown(scene) if kind.by_arm else list(range(len(view.cameras)))
    if not shown:
        return None
    try:
        return codes_of(scene.world, kind.plant(rng, scene, view, int(rng.choice(shown))))
    except (ImageError, ScenarioError):
        return {"refused"}


def is_found(codes: set[str], kind: Kind) -> bool:
    """Whether the codes name the mistake."""
    return bool(codes & (kind.finds | {"refused"}))


def wilson(hits: int, total: int) -> str:
    """A share with its interval of 95 %."""
    ends = binomtest(hits, total).proportion_ci(method="wilson")
    return f"{hits} of {total}, {100 * hits / total:.1f} % ({100 * ends.low:.1f} to {100 * ends.high:.1f})"


def measured(
    world: SpatialWorld,
    views: int,
    kinds: dict[str, Kind],
    *,
    clean: bool,
    split: Split,
    seed: int,
    seen: Callable[[SpatialScene], DepthView] = SpatialScene.view,
) -> tuple[dict[str, list[set[str]]], list[set[str]], float]:
    """Codes found in planted views by kind, in clean ones, and the mean time of a diagnosis in s."""
    found: dict[str, list[set[str]]] = {name: [] for name in kinds}
    alarms: list[set[str]] = []
    rng, names, spent = np.random.default_rng([seed, 7]), list(kinds), 0.0
    for scene in scenes(world, split, seed):
        done = sum(map(len, found.values()))
        if done + len(alarms) >= views:
            break
        view, began = seen(scene), time.perf_counter()
        if clean and len(alarms) <= done:
            alarms.append(codes_of(world, view))
        else:
            name = names[done % len(names)]
            codes = planted(rng, scene, view, kinds[name])
            if codes is not None:
                found[name].append(codes)
        spent += time.perf_counter() - began
    return found, alarms, spent / views


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--views", type=int, default=1000, help="half of them with a mistake")
    parser.add_argument(
        "--pose-errors", type=int, default=200, help="views with an error of 2 cm or 2 degrees"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--split", type=Split, default=Split.TEST)
    parser.add_argument("--urdf", type=Path, help="the Panda's description: draw the arm by its meshes")
    options = parser.parse_args()
    world = examples()["panda"]
    assert isinstance(world, SpatialWorld)  # noqa: S101 - by its name
    seen = SpatialScene.view if options.urdf is None else MeshArm(world, options.urdf).view
    print(machine())
    for views, kinds, clean in ((options.views, KINDS, True), (options.pose_errors, EXACT, False)):
        found, alarms, spent = measured(
            world, views, kinds, clean=clean, split=options.split, seed=options.seed, seen=seen
        )
        hits = 0
        for name, rows in found.items():
            held = [is_found(codes, kinds[name]) for codes in rows]
            hits += sum(held)
            if rows:
                common = ", ".join(
                    f"{code} {n}" for code, n in Counter(c for r in rows for c in r).most_common(4)
                )
                print(f"{name:<26}{wilson(sum(held), len(rows))}; {common}", flush=True)
        print(f"{'found':<26}{wilson(hits, sum(map(len, found.values())))}; {1e3 * spent:.0f} ms a view")
        if clean:
            codes_seen = Counter(code for codes in alarms for code in codes)
            print(
                f"{'false alarms':<26}{wilson(sum(map(bool, alarms)), len(alarms))}; {dict(codes_seen)}",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
