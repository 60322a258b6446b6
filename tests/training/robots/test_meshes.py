from pathlib import Path

import numpy as np
import pytest

from cspace.errors import ScenarioError
from training.robots.covering import Allowances, cover, depth_m, measure
from training.robots.meshes import Mesh, box_mesh, cylinder_mesh, file_mesh, sphere_mesh

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
POINTS = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.0, 0.5]])


def test_depth_is_the_distance_to_the_surface_with_a_sign() -> None:
    box = box_mesh(np.array([0.2, 0.4, 0.6]))
    np.testing.assert_allclose(box.depth_m(POINTS), [0.1, 0.05, -0.1, -0.2], atol=1e-12)
    corner = np.array([[0.1 + 0.03, 0.2 + 0.04, 0.0], [0.13, 0.24, 0.3 + 0.12]])
    np.testing.assert_allclose(box.depth_m(corner), [-0.05, -0.13], atol=1e-12)
    np.testing.assert_allclose(cylinder_mesh(0.1, 0.6).depth_m(POINTS), [0.1, 0.05, -0.1, -0.2], atol=1e-3)
    np.testing.assert_allclose(sphere_mesh(0.1).depth_m(POINTS), [0.1, 0.05, -0.1, -0.4], atol=1e-3)


def test_a_mesh_with_a_missing_triangle_has_an_inside() -> None:
    whole = sphere_mesh(0.1)
    open_ = Mesh(np.delete(whole.corners, 500, axis=0))
    assert (open_.depth_m(POINTS) > 0.0).tolist() == [True, True, False, False]


def test_the_turn_of_triangles_does_not_matter() -> None:
    box = box_mesh(np.array([0.2, 0.4, 0.6]))
    np.testing.assert_allclose(Mesh(box.corners[:, ::-1]).depth_m(POINTS), box.depth_m(POINTS))


def test_points_of_the_surface_lie_on_it() -> None:
    box = box_mesh(np.array([0.2, 0.4, 0.6]))
    points = box.surface(0.01, np.random.default_rng(0))
    assert np.abs(box.depth_m(points)).max() < 2e-6
    assert len(points) > 8800


def test_a_union_is_as_deep_as_its_deepest_part() -> None:
    pair = (box_mesh(np.array([0.2, 0.2, 0.2])), sphere_mesh(0.03))
    np.testing.assert_allclose(depth_m(pair, POINTS[:1]), [0.1], atol=1e-12)


def test_a_fit_tells_what_is_missed_and_what_sticks_out() -> None:
    fit = measure([sphere_mesh(0.1)], np.array([[0.02, 0.0, 0.0, 0.1]]), np.random.default_rng(0))
    assert fit.spheres == 1
    assert fit.missed_m == pytest.approx(0.02, abs=1e-3)
    assert fit.excess_m == pytest.approx(0.02, abs=1e-3)
    assert 0.4 < fit.missed_share < 0.6


def test_allowances_below_a_millimetre_are_refused() -> None:
    with pytest.raises(ScenarioError, match=r"0\.001 m or more"):
        Allowances(excess_m=0.0)


@pytest.mark.slow
def test_a_ball_needs_one_sphere() -> None:
    spheres = cover([sphere_mesh(0.01)], Allowances(), np.random.default_rng(0))
    assert len(spheres) == 1
    assert 0.008 < spheres[0, 3] <= 0.02


def test_mesh_files_are_scaled(tmp_path: Path) -> None:
    pytest.importorskip("coal")
    file = tmp_path / "corner.obj"
    file.write_text(OBJ, encoding="utf-8")
    mesh = file_mesh(file, np.array([2.0, 1.0, 1.0]))
    assert mesh.corners.shape == (4, 3, 3)
    np.testing.assert_allclose(mesh.corners.max(axis=(0, 1)), [2.0, 1.0, 1.0])
    assert mesh.depth_m(np.array([[0.1, 0.1, 0.1]]))[0] == pytest.approx(0.1)


@pytest.mark.parametrize("scale", [0.0, 1e-300, 1e300])
def test_a_scale_that_leaves_no_mesh_is_refused(tmp_path: Path, scale: float) -> None:
    pytest.importorskip("coal")
    file = tmp_path / "corner.obj"
    file.write_text(OBJ, encoding="utf-8")
    with pytest.raises(ScenarioError, match="a mesh does not fit"):
        file_mesh(file, np.full(3, scale))


def test_a_needle_has_a_bounded_number_of_points() -> None:
    needle = cylinder_mesh(1e-4, 10.0)
    assert len(needle.surface(5e-4, np.random.default_rng(0))) < 300_000


def test_a_file_that_is_no_mesh_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("coal")
    file = tmp_path / "bad.stl"
    file.write_text("no mesh", encoding="utf-8")
    with pytest.raises(ScenarioError, match="a mesh cannot be read"):
        file_mesh(file, np.ones(3))
