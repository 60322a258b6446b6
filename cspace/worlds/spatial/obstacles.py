"""Obstacles in space: boxes and cylinders with a pose, as values and as arrays."""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import Record, validated
from cspace.worlds.spatial.poses import MAX_PLACE_M, Pose, check_pose, make_pose, pose_of, vector

MAX_OBSTACLES = 1000
_LEAF = 4
_Size = Annotated[float, Field(gt=0.0, le=MAX_PLACE_M, strict=True)]


@validated(ScenarioError)
class Box(Record):
    """A cuboid; ``pose`` is of its centre, rows of a 4 x 4 matrix in the base frame, m."""

    pose: Pose
    half_m: tuple[_Size, _Size, _Size]

    def __post_init__(self) -> None:
        check_pose(self.pose, "a box")


@validated(ScenarioError)
class Cylinder(Record):
    """A solid round cylinder."""

    pose: Pose  # of its centre, rows of a 4 x 4 matrix in the base frame, m; its axis is its own z
    radius_m: _Size
    half_length_m: _Size

    def __post_init__(self) -> None:
        check_pose(self.pose, "a cylinder")


class BodyArrays(NamedTuple):
    """K bodies as the kernels take them: boxes first, then cylinders, spheres and meshes."""

    # (B, 16): centre 3, rotation 9 (row by row, its columns are the box's axes), half sizes 3, radius of the
    # sphere round it
    boxes: NDArray[np.float64]
    cylinders: NDArray[np.float64]  # (C, 15): centre, rotation, radius, half length, sphere's radius
    spheres: NDArray[np.float64]  # (Q, 4) centres and radii, m
    corners: NDArray[np.float64]  # (T, 3, 3) of all triangles, m, in the order of the trees' leaves
    lows: NDArray[np.float64]  # (M, 3) lowest corner of each node's box
    highs: NDArray[np.float64]  # (M, 3) highest corner
    rights: NDArray[np.int64]  # (M,) the second child, the first is the next node; -1 of a leaf
    firsts: NDArray[np.int64]  # (M,) a leaf's first triangle
    counts: NDArray[np.int64]  # (M,) of a leaf's triangles
    roots: NDArray[np.int64]  # (R,) of the meshes' trees
    closed: NDArray[np.bool_]  # (R,) whether a mesh bounds a solid
    centres: NDArray[np.float64]  # (K, 3) of a sphere round each body
    reaches: NDArray[np.float64]  # (K,) its radius
    exempt: NDArray[np.bool_]  # (P, K) parts of the arm that may touch a body


def body_arrays(
    boxes: Sequence[ArrayLike],
    cylinders: Sequence[ArrayLike],
    spheres: Sequence[ArrayLike] = (),
    meshes: Sequence[NDArray[np.float64]] = (),
) -> BodyArrays:
    """The arrays of bodies that no part of the arm may touch; meshes are corners (T, 3, 3) m."""
    held = ((boxes, 16), (cylinders, 15), (spheres, 4))
    kinds = [np.asarray(rows, dtype=np.float64).reshape(-1, width) for rows, width in held]
    rounds = [(mesh.min(axis=(0, 1)), mesh.max(axis=(0, 1))) for mesh in meshes]
    centres = [rows[:, :3] for rows in kinds] + [((low + high) / 2.0)[None] for low, high in rounds]
    reaches = [rows[:, -1] for rows in kinds]
    reaches += [np.array([np.linalg.norm(high - low) / 2.0]) for low, high in rounds]
    nodes: list[tuple[Any, ...]] = []
    ordered: list[NDArray[np.float64]] = [np.empty((0, 3, 3))]
    roots = []
    for mesh in meshes:
        roots.append(len(nodes))
        order = _add_nodes(mesh, nodes, sum(map(len, ordered)))
        ordered.append(mesh[order])
    lows, highs, rights, firsts, counts = zip(*nodes, strict=True) if nodes else ((),) * 5
    every = np.concatenate(centres)
    return BodyArrays(
        kinds[0],
        kinds[1],
        kinds[2],
        np.concatenate(ordered),
        np.asarray(lows, dtype=np.float64).reshape(-1, 3),
        np.asarray(highs, dtype=np.float64).reshape(-1, 3),
        np.asarray(rights, dtype=np.int64),
        np.asarray(firsts, dtype=np.int64),
        np.asarray(counts, dtype=np.int64),
        np.asarray(roots, dtype=np.int64),
        np.asarray([_is_closed(mesh) for mesh in meshes], dtype=np.bool_),
        every,
        np.concatenate(reaches),
        np.zeros((0, len(every)), dtype=np.bool_),
    )


def _add_nodes(mesh: NDArray[np.float64], nodes: list[tuple[Any, ...]], first: int) -> NDArray[np.int64]:
    """Add the nodes of a mesh's tree; the order of its triangles, the first of which has a number."""
    lows, highs = mesh.min(axis=1), mesh.max(axis=1)
    middles = (lows + highs) / 2.0
    leaves: list[NDArray[np.int64]] = []

    def add(some: NDArray[np.int64]) -> None:
        at = len(nodes)
        box = lows[some].min(axis=0), highs[some].max(axis=0)
        if len(some) <= _LEAF:
            nodes.append((*box, -1, first + sum(map(len, leaves)), len(some)))
            leaves.append(some)
            return
        nodes.append(())
        axis = int(np.argmax(np.ptp(middles[some], axis=0)))
        halves = np.argpartition(middles[some, axis], len(some) // 2)
        add(some[halves[: len(some) // 2]])
        right = len(nodes)
        add(some[halves[len(some) // 2 :]])
        nodes[at] = (*box, right, 0, 0)

    add(np.arange(len(mesh)))
    return np.concatenate(leaves)


def _is_closed(mesh: NDArray[np.float64]) -> bool:
    """Whether every edge belongs to two triangles, with corners that are equal taken as one."""
    _, names = np.unique(mesh.reshape(-1, 3), axis=0, return_inverse=True)
    names = names.reshape(-1, 3)
    edges = np.sort(np.concatenate([names[:, [0, 1]], names[:, [1, 2]], names[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return bool((counts == 2).all())


@validated(ScenarioError)
class Obstacles(Record):
    """What stands in a scene; together at most 1000."""

    boxes: tuple[Box, ...] = ()
    cylinders: tuple[Cylinder, ...] = ()

    def __post_init__(self) -> None:
        if len(self) > MAX_OBSTACLES:
            raise ScenarioError(
                "the scene has too many obstacles", expected=f"at most {MAX_OBSTACLES}", got=str(len(self))
            )

    def __len__(self) -> int:
        return len(self.boxes) + len(self.cylinders)

    @property
    def shapes(self) -> tuple[Box | Cylinder, ...]:
        return (*self.boxes, *self.cylinders)

    @classmethod
    def of(cls, shapes: Iterable[Box | Cylinder]) -> "Obstacles":
        every = tuple(shapes)
        return cls(
            tuple(one for one in every if isinstance(one, Box)),
            tuple(one for one in every if isinstance(one, Cylinder)),
        )

    @property
    def arrays(self) -> BodyArrays:
        """For kernels; not to be written to."""
        return _arrays(self)


@lru_cache(maxsize=16)
def _arrays(obstacles: Obstacles) -> BodyArrays:
    boxes = [kernel_row(one.pose, one.half_m) for one in obstacles.boxes]
    cylinders = [kernel_row(one.pose, (one.radius_m, one.half_length_m)) for one in obstacles.cylinders]
    return body_arrays(boxes, cylinders)


def kernel_row(pose: ArrayLike, half_m: ArrayLike) -> NDArray[np.float64]:
    """A row of :class:`BodyArrays`: a shape by its pose (4, 4), half sizes or radius and half length."""
    matrix, sizes = np.asarray(pose, dtype=np.float64), np.asarray(half_m, dtype=np.float64)
    return np.concatenate([matrix[:3, 3], matrix[:3, :3].ravel(), sizes, [np.hypot.reduce(sizes)]])


NO_BODIES = body_arrays((), ())

# Place 3, rotation 9 (row by row), half sizes 3; of cylinders radius and half length 2.
BOX_VALUES, CYLINDER_VALUES = 15, 14
# Of one kind in a scene.
MOST = 192


def rows_of(obstacles: Obstacles) -> dict[str, NDArray[np.float64]]:
    """``boxes`` (192, 15) and ``cylinders`` (192, 14), in the order of the obstacles, NaN behind the last."""
    arrays = obstacles.arrays
    return {
        "boxes": _padded(arrays.boxes[:, :BOX_VALUES]),
        "cylinders": _padded(arrays.cylinders[:, :CYLINDER_VALUES]),
    }


def obstacles_of(boxes: ArrayLike, cylinders: ArrayLike) -> Obstacles:
    """The inverse of :func:`rows_of`: (any, 15) and (any, 14)."""
    made: list[Box | Cylinder] = [Box(_pose(row), vector(row[12:])) for row in _held(boxes)]
    made += [Cylinder(_pose(row), float(row[12]), float(row[13])) for row in _held(cylinders)]
    return Obstacles.of(made)


def _held(rows: ArrayLike) -> NDArray[np.float64]:
    values = np.asarray(rows, dtype=np.float64)
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _padded(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(rows) > MOST:
        raise ScenarioError(
            "the scene is too full for a data set", expected=f"at most {MOST}", got=str(len(rows))
        )
    return np.pad(rows, ((0, MOST - len(rows)), (0, 0)), constant_values=np.nan)


def _pose(row: NDArray[np.float64]) -> Pose:
    return pose_of(make_pose(row[3:12].reshape(3, 3), row[:3]))
