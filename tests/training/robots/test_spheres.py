from pathlib import Path

import numpy as np
import pytest
import trimesh

from cspace.errors import ScenarioError
from tests.training.robots.descriptions import TWO_LINKS, described
from training.robots.importing import Imported, import_robot
from training.robots.spheres import (
    Allowances,
    Solid,
    cover,
    load_mesh,
    measure,
)

CORNER = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
POINTS = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.5]])
BOX = trimesh.creation.box(extents=[0.2, 0.4, 0.6])
BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.1)


def test_depth_is_the_distance_to_the_surface_with_a_sign() -> None:
    box = Solid(BOX.copy())
    np.testing.assert_allclose(box.depth_m(POINTS), [0.1, 0.05, -0.1, -0.2], atol=1e-12)
    corner = np.array([[0.1 + 0.03, 0.2 + 0.04, 0.0], [0.13, 0.24, 0.3 + 0.12]])
    np.testing.assert_allclose(box.depth_m(corner), [-0.05, -0.13], atol=1e-12)
    np.testing.assert_allclose(Solid(BALL.copy()).depth_m(POINTS), [0.1, 0.05, -0.1, -0.4], atol=1e-3)


def test_a_mesh_with_a_hole_or_turned_triangles_has_an_inside() -> None:
    open_, turned = BALL.copy(), BALL.copy()
    open_.update_faces(np.arange(len(open_.faces)) != 500)
    turned.invert()
    for mesh in (open_, turned):
        assert (Solid(mesh).depth_m(POINTS) > 0.0).tolist() == [True, True, False, False]


def test_a_fit_tells_what_is_missed_and_what_sticks_out() -> None:
    fit = measure([Solid(BALL.copy())], np.array([[0.02, 0.0, 0.0, 0.1]]), np.random.default_rng(0))
    assert fit.spheres == 1
    assert fit.missed_m == pytest.approx(0.02, abs=1e-3)
    assert fit.excess_m == pytest.approx(0.02, abs=1e-3)


@pytest.mark.slow
def test_a_ball_needs_one_sphere_and_a_large_stand_is_covered() -> None:
    spheres = cover([Solid(BALL.copy().apply_scale(0.1))], Allowances(), np.random.default_rng(0))
    assert len(spheres) == 1
    assert 0.008 < spheres[0, 3] <= 0.02
    stand = [Solid(trimesh.creation.box(extents=[0.8, 0.8, 0.9]))]
    allowances = Allowances().of(stand)
    assert 0.02 < allowances.excess_m < 0.03
    assert Allowances(relaxed=False).of(stand).excess_m == 0.01
    fit = measure(stand, cover(stand, allowances, np.random.default_rng(0)), np.random.default_rng(1))
    assert fit.missed_m < 0.0022
    assert fit.excess_m < allowances.excess_m
    assert fit.spheres < 400


def test_mesh_files_are_scaled_and_mirrored(tmp_path: Path) -> None:
    file = tmp_path / "corner.obj"
    file.write_text(CORNER, encoding="utf-8")
    mesh = load_mesh(file, np.array([2.0, 1.0, -1.0]), "link a")
    np.testing.assert_allclose(mesh.bounds, [[0.0, 0.0, -1.0], [2.0, 1.0, 0.0]])
    depth = Solid(mesh).depth_m(np.array([[0.1, 0.1, -0.1], [0.1, 0.1, 0.1]]))
    np.testing.assert_allclose(depth, [0.1, -0.1])


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("bad.stl", "no mesh"),
        ("bad.obj", "v 0 0 0\nf 1 2 3\n"),
        ("bad.dae", "<COLLADA/>"),
        ("bad.step", "ISO-10303-21;"),
        ("far.ply", BOX.export(file_type="ply", encoding="ascii").decode().replace("3 1 3 0", "3 1 99 0")),
        ("nan.obj", CORNER.replace("v 1 0 0", "v nan 0 0")),
        # A reader that ends at what is no number leaves out what follows.
        ("cut.obj", CORNER.replace("f 1 2 4", "f x 2 4")),
        ("cut.stl", BOX.export(file_type="stl_ascii").replace("vertex", "vertex x", 13).replace("x", "", 12)),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(tmp_path: Path, name: str, data: str) -> None:
    file = tmp_path / name
    file.write_text(data, encoding="utf-8")
    with pytest.raises(ScenarioError, match="a mesh of link a cannot be read"):
        load_mesh(file, np.ones(3), "link a")


def test_corners_of_no_triangle_are_no_points_of_the_surface(tmp_path: Path) -> None:
    file = tmp_path / "corner.obj"
    file.write_text(f"{CORNER}v 9 9 9\n", encoding="utf-8")
    solid = Solid(load_mesh(file, np.ones(3), "link a"))
    assert np.abs(solid.depth_m(solid.surface(50, np.random.default_rng(0)))).max() < 1e-9


def _imported(folder: Path, mesh: str) -> Imported:
    text = TWO_LINKS.replace('<sphere radius="0.12"/>', f'<mesh filename="{mesh}"/>')
    for shape in ('<cylinder radius="0.05" length="0.3"/>', '<box size="0.04 0.06 0.1"/>'):
        text = text.replace(shape, '<sphere radius="0.05"/>')
    return import_robot(described(folder, text))


def _two_boxes(end: str) -> str:
    """Two boxes, round the origin and round (0.3, 0, 0), of two materials in OBJ or in two DAE nodes."""
    first = trimesh.creation.box(extents=[0.08, 0.06, 0.04])
    second = first.copy().apply_translation([0.3, 0.0, 0.0])
    if end == "dae":
        return trimesh.exchange.dae.export_collada([first, second]).decode()
    rows = [f"v {x} {y} {z}" for mesh in (first, second) for x, y, z in mesh.vertices.tolist()]
    for number, mesh in enumerate((first, second)):
        rows.append(f"usemtl m{number}")
        rows += [f"f {a} {b} {c}" for a, b, c in (mesh.faces + 1 + 8 * number).tolist()]
    return "\n".join(rows)


@pytest.mark.slow
def test_all_materials_of_a_mesh_are_covered(tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(_two_boxes("obj"), encoding="utf-8")
    part = _imported(tmp_path, "two.obj").arm.parts[0]
    spheres = np.asarray(part.spheres_m)
    corners = trimesh.creation.box(extents=[0.08, 0.06, 0.04]).vertices
    for place in ([0.0, 0.0, 0.0], [0.3, 0.0, 0.0]):
        gaps = np.linalg.norm((corners + place)[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3]
        assert gaps.min(axis=1).max() < 0.002


def test_a_collada_mesh_is_read_in_its_unit_with_all_its_nodes(tmp_path: Path) -> None:
    file = tmp_path / "two.dae"
    file.write_text(_two_boxes("dae"), encoding="utf-8")
    text = file.read_text(encoding="utf-8")
    assert load_mesh(file, np.ones(3), "link a").area == pytest.approx(0.0416)
    file.write_text(text.replace("<asset>", '<asset><unit name="inch" meter="0.0254"/>'), encoding="utf-8")
    mesh = load_mesh(file, np.ones(3), "link a")
    np.testing.assert_allclose(mesh.bounds[1], np.array([0.34, 0.03, 0.02]) * 0.0254, rtol=1e-5)
