"""How far about the cheapest way through each cell would lead, and how far along it the cell would be.

The ways are those of :mod:`training.paths.ways`: a rad costs the more the surer the validity head is of a
collision. Training and a served graph have them from the same ONNX graph; for training they are stored as
bytes.
"""

from typing import Any

import numpy as np
import onnx
from numpy.typing import ArrayLike, NDArray
from onnx import inliner
from torch import Tensor

from cspace.bundle.running.runtime import onnx_runtime
from cspace.space import JointSpace
from training.models.ways.graph import fixed, way_constants
from training.models.ways.steps import way_maps

# Beyond it a way is as good as none.
FARTHEST_RAD = 2.55
# As many as the longest way has cells.
SWEEPS = 64
_STEP_RAD = 0.01


class WayFields:
    """Detour and progress of every cell for a map of the validity head, with start and goal.

    Args:
        space: the joint space, of two joints.
        cells: of the map along each joint.
        penalty: what a rad costs more where the head is sure of a collision.
    """

    def __init__(self, space: JointSpace, cells: int, penalty: float) -> None:
        runtime = onnx_runtime()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = 1
        # The library warns of constants that it leaves as they are.
        options.log_severity_level = 4
        graph = way_maps_graph(space, cells, penalty).SerializeToString()
        self._session = runtime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        self._shape = (3, cells, cells)

    def of(self, confidence: NDArray[Any], start: ArrayLike, goal: ArrayLike) -> NDArray[np.float32]:
        """Of one map (c, c) and two configurations (2,) rad.

        Returns:
            (2, c, c): by how much the cheapest way through each cell is dearer than the cheapest of all, up
            to ``FARTHEST_RAD``; and which share of its cost lies behind it there, 0 where no way leads.
        """
        ends = {"start": start, "goal": goal}
        fed = {name: np.asarray(end, dtype=np.float32).reshape(1, 2) for name, end in ends.items()}
        seen = np.asarray(confidence, dtype=np.float32).ravel()
        (maps,) = self._session.run(["maps"], {**fed, "confidence": seen})
        found: NDArray[np.float32] = np.reshape(maps, self._shape)[1:]
        return found


def fields_to_store(fields: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Detour and progress (2, c, c) as bytes."""
    detour, progress = fields
    return np.round(np.stack([detour / _STEP_RAD, progress * 255.0])).astype(np.uint8)


def stored_fields(stored: Tensor) -> tuple[Tensor, Tensor]:
    """Detour and progress (b, 1, c, c) of what was stored (b, 2, c, c)."""
    values = stored.float()
    return values[:, :1] * _STEP_RAD, values[:, 1:] / 255.0


def backwards(detour: Tensor, progress: Tensor) -> Tensor:
    """The progress of the same ways from goal to start."""
    return (1.0 - progress) * (detour < FARTHEST_RAD - _STEP_RAD / 2.0)


def way_maps_graph(space: JointSpace, cells: int, penalty: float) -> onnx.ModelProto:
    """A graph from ``confidence`` (n,), ``start`` and ``goal`` (m, 2) rad to ``maps`` (3 n,).

    The maps are confidence, detour and progress, one after the other.
    """
    constants = way_constants(space, cells) | {
        "penalty": np.array(penalty, dtype=np.float32),
        "sweeps": np.array(SWEEPS, dtype=np.int64),
        "farthest": np.array(FARTHEST_RAD, dtype=np.float32),
    }
    graph = inliner.inline_local_functions(way_maps.to_model_proto())  # type: ignore[no-untyped-call]
    return fixed(graph, constants)
