"""How right the checks of known and attached bodies are, against Pinocchio and Coal with the robot's meshes.

    python -m benchmarks.spatial.known_bodies [--scenes 200] [--rows 50]

In each scene of the project's own families (validation), whose boxes and cylinders are known, a ball and a
convex mesh more stand somewhere, and the hand holds a box, a cylinder or a convex mesh. Configurations are
uniform. The truth is the signed distance between the shapes: of the parts that move to the bodies, of
what is held to the bodies and to the parts that it may not touch. The arm's own self-collision is left out on
both sides. Then the time of 1000 configurations beside 100 bodies and beside none. One process, minutes.
"""

import base64
import json
import sys
import time
from typing import Any

import coal
import numpy as np
import pinocchio
import trimesh

from benchmarks.command import arguments, spread
from benchmarks.machine import machine
from cspace.simulator import Split
from cspace.worlds import examples
from cspace.worlds.spatial.furniture import SpatialScenes
from cspace.worlds.spatial.mesh_checker import Description, RobotMeshes, panda_urdf
from cspace.worlds.spatial.planning_scene import read_planning_scene
from cspace.worlds.spatial.poses import make_pose, turned
from cspace.worlds.spatial.scenes import draw_layout
from cspace.worlds.spatial.situation import Situation

WORLD = examples()["panda"]
HAND = ("panda_link7", "panda_hand", "panda_leftfinger", "panda_rightfinger")
DEEP_M, REPEATS = 0.005, 20


def hull(rng: np.random.Generator, size_m: float) -> trimesh.Trimesh:
    """A convex mesh about the origin."""
    return trimesh.convex.convex_hull(rng.normal(size=(24, 3)) * size_m / 2.0)


def placed(rng: np.random.Generator) -> list[list[float]]:
    """A pose somewhere before the arm."""
    turn = turned(*rng.uniform(-np.pi, np.pi, 3))
    return make_pose(turn, rng.uniform((0.2, -0.7, 0.1), (0.8, 0.7, 0.9))).tolist()


def drawn(rng: np.random.Generator, number: int) -> tuple[dict[str, Any], dict[str, trimesh.Trimesh]]:
    """A planning scene in plain values, and its meshes."""
    obstacles = draw_layout(SpatialScenes(), Split.VALIDATION, 0, number).obstacles
    scene: list[dict[str, Any]] = [
        {"box": {"size_m": [2.0 * half for half in one.half_m]}, "pose": one.pose} for one in obstacles.boxes
    ]
    scene += [
        {"cylinder": {"radius_m": one.radius_m, "length_m": 2.0 * one.half_length_m}, "pose": one.pose}
        for one in obstacles.cylinders
    ]
    meshes = {"stone": hull(rng, 0.15), "part": hull(rng, 0.06)}
    scene.append({"sphere": {"radius_m": float(rng.uniform(0.03, 0.12))}, "pose": placed(rng)})
    scene.append({"mesh": {"file": "stone"}, "pose": placed(rng)})
    held: dict[str, Any] = [
        {"box": {"size_m": rng.uniform(0.03, 0.2, 3).tolist()}},
        {"cylinder": {"radius_m": float(rng.uniform(0.02, 0.05)), "length_m": float(rng.uniform(0.08, 0.3))}},
        {"mesh": {"file": "part"}},
    ][number % 3]
    pose = make_pose(turned(*rng.uniform(-np.pi, np.pi, 3)), (0.0, 0.0, 0.08)).tolist()
    values = {
        "scene": [{"name": f"body {at}", **one} for at, one in enumerate(scene)],
        "attached": [{"name": "held", **held, "pose": pose, "touch_links": HAND}],
    }
    return values, meshes


class Truth:
    """Signed distances between the shapes of a scene.

    Args:
        robot: its meshes.
        values: the scene.
        meshes: of it.
    """

    def __init__(
        self, robot: RobotMeshes, values: dict[str, Any], meshes: dict[str, trimesh.Trimesh]
    ) -> None:
        self._robot, self._geometry = robot, robot.geometry.copy()
        model, arm = robot.model, robot.arm
        links = {part.name: part.link for part in arm.parts}
        names = [model.frames[shape.parentFrame].name for shape in robot.geometry.geometryObjects]
        moving = [at for at, name in enumerate(names) if links.get(name, 0) > 0]
        (held,) = values["attached"]
        last = model.getJointId(arm.joints[-1].name)
        tool = arm.tool.matrix() @ np.asarray(held["pose"])
        self._add("held", last, tool, held, meshes)
        own = self._geometry.ngeoms - 1
        for at, name in enumerate(names):
            if name not in HAND and links.get(name, arm.dim) < arm.dim:
                self._geometry.addCollisionPair(pinocchio.CollisionPair(at, own))
        for number, one in enumerate(values["scene"]):
            self._add(f"body {number}", 0, np.asarray(one["pose"]), one, meshes)
            for at in (*moving, own):
                self._geometry.addCollisionPair(pinocchio.CollisionPair(at, self._geometry.ngeoms - 1))
        self._model, self._data, self._shapes = model, model.createData(), self._geometry.createData()

    def _add(
        self,
        name: str,
        joint: int,
        pose: np.ndarray,
        one: dict[str, Any],
        meshes: dict[str, trimesh.Trimesh],
    ) -> None:
        if "box" in one:
            shape = coal.Box(*one["box"]["size_m"])
        elif "cylinder" in one:
            shape = coal.Cylinder(one["cylinder"]["radius_m"], one["cylinder"]["length_m"])
        elif "sphere" in one:
            shape = coal.Sphere(one["sphere"]["radius_m"])
        else:
            points = coal.StdVec_Vec3s()
            points.extend(np.asarray(meshes[one["mesh"]["file"]].vertices))
            shape = coal.Convex.convexHull(points, False, "Qt")  # noqa: FBT003 # takes no names
        left, _, right = np.linalg.svd(pose[:3, :3])
        place = pinocchio.SE3(left @ right, pose[:3, 3])
        self._geometry.addGeometryObject(pinocchio.GeometryObject(name, joint, place, shape))

    def clearance_m(self, rows: np.ndarray) -> np.ndarray:
        """Least signed distance at each of (N, d) rad, (N,) m."""
        found = np.empty(len(rows))
        for index, row in enumerate(rows):
            at = self._robot.configuration(row)
            nearest = pinocchio.computeDistances(self._model, self._data, self._geometry, self._shapes, at)
            found[index] = self._shapes.distanceResults[nearest].min_distance
        return found


def times_ms(count: int, rng: np.random.Generator) -> list[float]:
    """Of 1000 configurations beside so many bodies."""
    scene = [{"name": str(at), "box": {"size_m": [0.08] * 3}, "pose": placed(rng)} for at in range(count)]
    situation = Situation(WORLD.body, read_planning_scene(json.dumps({"scene": scene}).encode()))
    rows = WORLD.space.sample_uniform(rng, 1000)
    situation.free(rows)
    found = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        situation.free(rows)
        found.append(1e3 * (time.perf_counter() - began))
    return found


def main() -> int:
    """Prints the figures; returns the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--rows", type=int, default=50, help="configurations in each scene")
    options = parser.parse_args()
    urdf = panda_urdf()
    if urdf is None:
        parser.error("the package example-robot-data is not installed")
    fingers = {f"panda_finger_joint{number}": 0.065 for number in (1, 2)}
    robot = RobotMeshes(WORLD.body, Description(urdf, fingers))
    rng = np.random.default_rng(0)
    passed, truth = [], []
    for number in range(options.scenes):
        values, meshes = drawn(rng, number)
        files = {
            name: base64.b64encode(mesh.export(file_type="stl")).decode() for name, mesh in meshes.items()
        }
        situation = Situation(
            WORLD.body, read_planning_scene(json.dumps(values | {"meshes": files}).encode())
        )
        rows = WORLD.space.sample_uniform(rng, options.rows)
        passed.append(situation.free(rows))
        truth.append(Truth(robot, values, meshes).clearance_m(rows))
        if sys.stderr.isatty():
            print(f"\r{number + 1}/{options.scenes}", end="", file=sys.stderr)
    free, away = np.concatenate(passed), np.concatenate(truth)
    print(machine())
    print(f"{len(free)} configurations of {options.scenes} scenes, {(away > 0.0).mean():.3f} free in truth")
    wrong, refused = -away[free & (away <= 0.0)], (~free & (away > 0.0)).sum()
    deepest_m = wrong.max(initial=0.0)
    print(
        f"free by mistake: {len(wrong)}, {(wrong > DEEP_M).sum()} deeper than 5 mm, at most {deepest_m:.4f} m"
    )
    print(f"refused by mistake: {refused / (away > 0.0).sum():.4f} of those that are free")
    for count in (0, 100):
        print(f"1000 configurations beside {count} bodies: {spread(times_ms(count, rng), 2)} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
