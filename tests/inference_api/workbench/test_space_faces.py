"""Faces that a page paints: flat, outwards, and together the whole surface."""

import numpy as np
import pytest

from inference_api.workbench.space_faces import Face, faces_of

# A quarter turn about z, and somewhere else.
POSE = [[0.0, -1.0, 0.0, 0.5], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]]
MIDDLE = np.array([0.5, 0.2, 0.3])
BOX = {"pose": POSE, "half_m": [0.3, 0.1, 0.05]}
CYLINDER = {"pose": POSE, "radius_m": 0.1, "half_length_m": 0.2}
SHAPES = {"box": {"boxes": [BOX], "cylinders": []}, "cylinder": {"boxes": [], "cylinders": [CYLINDER]}}


def area_and_lean(face: Face) -> tuple[float, float]:
    """The area in m2, and how far its normal leads away from the middle of its obstacle, m."""
    points, normal = np.array(face.points), np.array(face.normal)
    around = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(axis=0)
    # Flat, and its normal is that of its corners on one side or the other.
    assert abs(around @ normal) == pytest.approx(np.linalg.norm(around), rel=1e-2)
    return float(np.linalg.norm(around)) / 2.0, float((points.mean(axis=0) - MIDDLE) @ normal)


@pytest.mark.parametrize(
    ("name", "surface_m2"),
    [
        ("box", 8.0 * (0.3 * 0.1 + 0.3 * 0.05 + 0.1 * 0.05)),
        # Of a prism with 14 sides.
        ("cylinder", 28.0 * 0.1 * np.sin(np.pi / 14) * 0.4 + 14.0 * 0.01 * np.sin(np.pi / 7)),
    ],
)
def test_faces_are_the_whole_surface_and_lead_outwards(name: str, surface_m2: float) -> None:
    told = [area_and_lean(face) for face in faces_of(SHAPES[name])]
    assert sum(area for area, _ in told) == pytest.approx(surface_m2, rel=5e-3)
    assert all(lean > 0.0 for _, lean in told)


def test_a_box_lies_where_its_pose_has_it_and_long_sides_are_cut() -> None:
    faces = faces_of(SHAPES["box"])
    points = np.array([point for face in faces for point in face.points])
    # Its long side is turned to y.
    np.testing.assert_allclose(points.min(axis=0), [0.4, -0.1, 0.25])
    np.testing.assert_allclose(points.max(axis=0), [0.6, 0.5, 0.35])
    # Three pieces along 0.6 m on four sides, and an end each.
    assert len(faces) == 4 * 3 + 2
