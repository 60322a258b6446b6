"""A planning scene beside depth pictures: known and attached bodies, allowed pairs, volumes to ignore."""

import base64
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from cspace.errors import InputError
from cspace.simulator import ProblemRequest, Split
from cspace.view_file import MAX_TRIANGLES, pack_view, unpack_view
from cspace.worlds import examples, partly_seen
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.bodies import points_to_bodies
from cspace.worlds.spatial.camera import DepthCamera, looking, to_mm
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.planning_scene import read_planning_scene, read_stl
from cspace.worlds.spatial.rendering import render_depth
from cspace.worlds.spatial.scene_checker import SceneChecker, bodies_of, cover
from cspace.worlds.spatial.sensor import FREE
from cspace.worlds.spatial.view import DepthView, write_view
from cspace.worlds.spatial.visibility import distances_m, lookup

WORLD = examples()["panda"]
ARM, GRID = WORLD.body, WORLD.sensor.grid
READY = ready_rad(ARM)
ROWS = WORLD.space.sample_uniform(np.random.default_rng(2), 400)
HAND = ("panda_hand", "panda_leftfinger", "panda_rightfinger")
TABLE = {"name": "table", "box": {"size_m": [1.2, 1.2, 0.1]}, "pose": {"translation": [0.3, 0.0, -0.05]}}


def stl_of(mesh):
    return base64.b64encode(mesh.export(file_type="stl")).decode()


def scene_of(**fields):
    return read_planning_scene(json.dumps(fields).encode())


def at(x, y, z):
    return {"translation": [x, y, z]}


def test_a_mesh_is_as_far_away_as_trimesh_says_and_a_closed_one_is_solid():
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3))
    for mesh in (trimesh.creation.torus(0.2, 0.05), trimesh.creation.box((0.3, 0.2, 0.1))):
        known = scene_of(
            scene=[{"name": "m", "mesh": {"file": "m.stl"}, "pose": at(0.1, -0.2, 0.3)}],
            meshes={"m.stl": stl_of(mesh)},
        )
        bodies = bodies_of(known.scene, known.corners_m())
        found = points_to_bodies(points + np.array([0.1, -0.2, 0.3]), bodies, 1.0)
        # That is above 0 inside.
        np.testing.assert_allclose(found, -trimesh.proximity.signed_distance(mesh, points), atol=1e-6)
    open_box = trimesh.creation.box((0.3, 0.2, 0.1))
    open_box.update_faces(np.arange(len(open_box.faces)) != 0)
    known = scene_of(scene=[{"name": "m", "mesh": {"file": "m"}}], meshes={"m": stl_of(open_box)})
    bodies = bodies_of(known.scene, known.corners_m())
    assert points_to_bodies(np.zeros((1, 3)), bodies, 1.0)[0] == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize(
    "shape",
    [
        {"box": {"size_m": [0.05, 0.08, 0.2]}},
        {"box": {"size_m": [0.002, 0.3, 0.2]}},
        {"cylinder": {"radius_m": 0.04, "length_m": 0.14}},
        {"sphere": {"radius_m": 0.05}},
        {"mesh": {"file": "m", "scale": 0.5}},
    ],
    ids=lambda shape: next(iter(shape)),
)
@pytest.mark.slow
def test_an_attached_body_is_covered_by_few_spheres_that_stick_out_little(shape):
    known = scene_of(
        attached=[{"name": "held", **shape}], meshes={"m": stl_of(trimesh.creation.torus(0.1, 0.03))}
    )
    (body,), meshes = known.attached, known.corners_m()
    spheres, bodies = cover(body, meshes), bodies_of([body], meshes)
    assert len(spheres) <= 1024
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (40_000, 3))
    away = points_to_bodies(points, bodies, 0.05)
    gaps = np.linalg.norm(points[:, None] - spheres[:, :3], axis=2) - spheres[:, 3]
    covered = gaps.min(axis=1) <= 0.0
    # Deep inside there may be none, for nothing comes there but through the surface.
    shell = (away <= -0.003) & (away > -0.005)
    assert shell.any() or body.sphere is not None or body.box is not None
    assert covered[shell].all()
    assert away[covered].max() < 0.01


def test_what_is_known_is_checked_as_the_simulator_checks_its_scenes():
    problem = partly_seen(WORLD).problem(ProblemRequest(Split.VALIDATION), "motionbench_table_pick", 1, 1)
    obstacles = problem.scenario.obstacles
    bodies = [
        {"name": f"box {at}", "box": {"size_m": [2.0 * half for half in one.half_m]}, "pose": one.pose}
        for at, one in enumerate(obstacles.boxes)
    ] + [
        {
            "name": f"cylinder {at}",
            "cylinder": {"radius_m": one.radius_m, "length_m": 2.0 * one.half_length_m},
            "pose": one.pose,
        }
        for at, one in enumerate(obstacles.cylinders)
    ]
    found = SceneChecker(ARM, scene_of(scene=bodies)).free(ROWS)
    alone = CollisionChecker(replace(ARM, touching=()), obstacles)
    np.testing.assert_array_equal(found, alone.valid_batch(ROWS))
    assert 0.1 < found.mean() < 0.95


def test_the_base_may_stand_in_a_table_and_pairs_that_are_allowed_may_touch():
    checker = SceneChecker(ARM, scene_of(scene=[TABLE]))
    assert checker.free(READY[None]).all()
    assert not checker.free(ROWS).all()
    allowed = [[part.name, "table"] for part in ARM.parts]
    assert SceneChecker(ARM, scene_of(scene=[TABLE], allowed=allowed)).free(ROWS).all()


def test_in_ignored_volumes_a_robot_is_certainly_free_where_it_touches_neither_bodies_nor_itself():
    assert not SceneChecker(ARM, scene_of(scene=[TABLE])).certain(ROWS).any()
    everything = SceneChecker(ARM, scene_of(scene=[TABLE], ignore=[{"box": {"size_m": [4.0, 4.0, 4.0]}}]))
    alone = CollisionChecker(ARM, Obstacles((), ())).valid_batch(ROWS)
    assert not alone.all()
    certain = everything.certain(ROWS)
    np.testing.assert_array_equal(certain, everything.free(ROWS) & alone)
    above = {"box": {"size_m": [4.0, 4.0, 4.0]}, "pose": at(0.0, 0.0, 2.1)}
    moving = ARM.sphere_links() > 0
    low = ARM.sphere_centres_m(ROWS)[:, moving, 2] - ARM.spheres_m()[moving, 3]
    found = SceneChecker(ARM, scene_of(scene=[TABLE], ignore=[above])).certain(ROWS)
    np.testing.assert_array_equal(found, certain & (low.min(axis=1) >= 0.1))
    assert 0 < found.sum() < certain.sum()
    rod = {"name": "rod", "cylinder": {"radius_m": 0.01, "length_m": 0.4}, "pose": at(0.0, 0.0, 2.6)}
    held = scene_of(attached=[rod], ignore=[{"box": {"size_m": [4.0, 4.0, 4.0]}}])
    assert SceneChecker(ARM, held).certain(READY[None]).tolist() == [False]


def test_an_attached_body_touches_what_the_hand_does_not():
    held = {"name": "rod", "cylinder": {"radius_m": 0.01, "length_m": 0.4}, "touch_links": HAND}
    held["pose"] = at(0.0, 0.0, 0.2)
    tool = ARM.tool_frames(READY[None])[0]
    x, y, z = (tool @ (0.0, 0.0, 0.25, 1.0))[:3]
    ball = {"name": "ball", "sphere": {"radius_m": 0.03}, "pose": at(x, y, z)}
    assert SceneChecker(ARM, scene_of(scene=[ball])).free(READY[None]).all()
    checker = SceneChecker(ARM, scene_of(scene=[ball], attached=[held]))
    assert not checker.free(READY[None]).any()
    image = np.zeros(WORLD.sensor.picture_shape, np.uint8)
    contact = checker.contact(READY, image, GRID)
    assert (contact.kind, contact.link, contact.other) == ("known", "rod", "ball")
    assert np.linalg.norm(np.subtract(contact.position_m, (x, y, z))) < 0.06
    assert "rod touches ball by" in contact.text
    allowed = scene_of(scene=[ball], attached=[held], allowed=[["ball", "rod"]])
    assert SceneChecker(ARM, allowed).free(READY[None]).all()
    # A rod back through the forearm.
    back = held | {"pose": at(0.0, 0.0, -0.2)}
    found = SceneChecker(ARM, scene_of(attached=[back])).contact(READY, image, GRID)
    assert (found.kind, found.link) == ("self", "rod")


def view_of(known=None):
    problem = partly_seen(WORLD).problem(ProblemRequest(Split.VALIDATION), "motionbench_table_pick", 1, 1)
    file = unpack_view(write_view(problem.scenario.view()))
    text = None if known is None else json.dumps(known).encode()
    return pack_view(file.pictures, file.cameras, file.state, known=text)


def test_known_bodies_are_in_the_picture_once_and_ignored_volumes_are_free():
    plain = WORLD.examine_picture(view_of()).images[0]
    box = {"name": "b", "box": {"size_m": [0.2, 0.2, 0.2]}, "pose": at(-0.4, 0.0, 0.5)}
    with_box = WORLD.examine_picture(view_of({"scene": [box]}))
    centres = GRID.centres_m()
    inside = (np.abs(centres - (-0.4, 0.0, 0.5)) < 0.1).all(axis=-1)
    assert (with_box.images[0][inside][:, 1] != FREE).all()
    away = np.abs(np.abs(centres - (-0.4, 0.0, 0.5)).max(axis=-1) - 0.1)
    near = inside & (away < 0.05)
    np.testing.assert_allclose(distances_m(with_box.images[0])[near], away[near], atol=2e-3)
    assert not with_box.known.free(ROWS).all()
    whole = {"box": {"size_m": [4.0, 4.0, 4.0]}}
    nothing = WORLD.examine_picture(view_of({"ignore": [whole]})).images[0]
    assert (nothing[..., 1] == FREE).all()
    assert (nothing[..., 0] == 255).all()
    assert (plain[..., 0] < 255).any()
    assert WORLD.examine_picture(view_of({"scene": []})).images[0].tobytes() == plain.tobytes()


def test_pixels_of_an_attached_body_are_removed_as_the_arms_are():
    known = scene_of(attached=[{"name": "rod", "cylinder": {"radius_m": 0.03, "length_m": 0.3}}])
    arm = SceneChecker(ARM, known).arm
    camera = DepthCamera.of_field(96, 96, 60.0, looking((1.4, 0.9, 0.7), (0.4, 0.0, 0.4)))
    picture = to_mm(render_depth(Obstacles(), camera, arm.spheres_at(READY)))
    view = DepthView((picture,), (camera,), tuple(READY.tolist()))
    end = arm.spheres_at(READY)[-1:, :3]
    held = WORLD.examined(replace(view, known=known)).known
    with_it, without = (lookup(one, GRID, end).distance_m[0] for one in (held.seen, WORLD.observed(view)))
    assert without < 0.05 < with_it


def tetrahedron(count=4, value=0.0):
    corners = np.zeros((count, 3, 3), "<f4")
    corners[:, 1:, :2] = np.eye(2)
    corners[0, 0, 0] = value
    rows = np.zeros(count, dtype=[("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    rows["c"] = corners
    return b"x" * 80 + struct.pack("<I", count) + rows.tobytes()


@pytest.mark.parametrize(
    "data",
    [
        b"solid part\n",
        tetrahedron()[:-1],
        tetrahedron(value=np.nan),
        tetrahedron(MAX_TRIANGLES + 1),
    ],
    ids=["text", "cut", "not finite", "too many"],
)
def test_a_mesh_that_is_none_is_refused(data):
    with pytest.raises(InputError):
        read_stl(data, "part.stl")


BALL = {"name": "a", "sphere": {"radius_m": 0.1}}


@pytest.mark.parametrize(
    "fields",
    [
        {"scene": [{"name": "a"}]},
        {"scene": [BALL | {"box": {"size_m": [1, 1, 1]}}]},
        {"scene": [{"name": "a", "sphere": {"radius_m": -0.1}}]},
        {"scene": [BALL, BALL]},
        {"scene": [BALL | {"pose": np.diag([1, 1, -1, 1]).tolist()}]},
        {"scene": [BALL | {"colour": "red"}]},
        {"scene": [{"name": "a", "mesh": {"file": "b.stl"}}]},
        {"scene": [BALL | {"name": str(i)} for i in range(600)]},
        {"attached": [BALL | {"link": "elbow"}]},
        {"attached": [BALL | {"link": "panda_hand"}]},
        {"attached": [BALL | {"touch_links": ["x"]}]},
        {"allowed": [["table", "panda_hand"]]},
        {"scene": [BALL | {"name": "panda_hand"}]},
    ],
)
def test_a_scene_that_is_none_is_refused(fields):
    with pytest.raises(InputError):
        SceneChecker(ARM, scene_of(**fields))
