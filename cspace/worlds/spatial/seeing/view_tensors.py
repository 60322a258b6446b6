"""What depth cameras saw of a scene, as arrays instead of files."""

import numpy as np

from cspace.space import JointSpace
from cspace.view_file import MAX_PICTURES
from cspace.world import Arrays, TensorInput
from cspace.worlds.spatial.seeing.view import DepthView, in_mm, read_pinhole, state_of

DEPTH, INTRINSICS, POSES, STATE, SCALE = "depth", "intrinsics", "poses", "state", "depth_scale_m"
_INTRINSICS = ("fx", "fy", "cx", "cy")


def view_tensors(dim: int) -> tuple[TensorInput, ...]:
    """Pictures, cameras and the arm's state.

    Pictures of one size; of each camera fx, fy, cx and cy, pixels, and its pose in the base frame, m; where
    the arm was, rad, absent where it is in no picture; metres per unit of the pictures, absent for mm.
    """
    return (
        TensorInput(DEPTH, "uint16", ("c", "h", "w"), MAX_PICTURES),
        TensorInput(INTRINSICS, "float64", ("c", len(_INTRINSICS)), MAX_PICTURES),
        TensorInput(POSES, "float64", ("c", 4, 4), MAX_PICTURES),
        TensorInput(STATE, "float64", (dim,), optional=True),
        TensorInput(SCALE, "float64", (1,), optional=True),
    )


def view_of_tensors(tensors: Arrays, space: JointSpace) -> DepthView:
    """The view of arrays that follow :func:`view_tensors`.

    Raises:
        ImageError: a picture, a camera or the state is none.
    """
    scale = tensors[SCALE].tolist()[0] if SCALE in tensors else None
    pictures = tuple(in_mm(np.ascontiguousarray(one, dtype=np.uint16), scale) for one in tensors[DEPTH])
    told = zip(tensors[INTRINSICS].tolist(), tensors[POSES].tolist(), pictures, strict=True)
    cameras = tuple(
        read_pinhole({**dict(zip(_INTRINSICS, numbers, strict=True)), "pose": pose}, picture.shape)
        for numbers, pose, picture in told
    )
    state = tensors[STATE].tolist() if STATE in tensors else None
    return DepthView(pictures, cameras, state_of(state, space))
