"""Mesh files, read by coal."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cspace.errors import ScenarioError


def load_triangles(path: Path) -> NDArray[np.float64]:
    """Corners of the triangles in a file, (T, 3, 3), in its unit.

    Raises:
        ScenarioError: coal is not installed, or cannot read the file.
    """
    try:
        import coal  # noqa: PLC0415 # an extra
    except ImportError as error:
        raise ScenarioError(
            "meshes cannot be read",
            expected="the extra spatial",
            got=f"no coal for {path.name}",
            remedy="pip install -c constraints.txt '.[spatial]'",
        ) from error
    try:
        model = coal.MeshLoader().load(str(path), np.ones(3))
        vertices = np.asarray(model.vertices(), dtype=np.float64)
        triangles = [model.tri_indices(index) for index in range(model.num_tris)]
        faces = [[one[corner] for corner in range(3)] for one in triangles]
    except (ValueError, RuntimeError) as error:
        raise ScenarioError(
            "a mesh cannot be read", expected="STL, OBJ or DAE", got=f"{path}: {error}"[:300]
        ) from error
    if not faces or not np.isfinite(vertices).all():
        raise ScenarioError("a mesh cannot be read", expected="triangles", got=f"none in {path}")
    return vertices[np.asarray(faces, dtype=np.int64)]
