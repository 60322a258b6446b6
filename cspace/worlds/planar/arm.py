"""The robot: a planar arm of revolute joints whose links are capsules."""

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from cspace.errors import ScenarioError
from cspace.files import Record, read_object, validated
from cspace.space import MIN_RANGE_RAD, JointSpace, is_range
from cspace.worlds.planar.camera import Length

_KIND = "planar_arm"
JointLimits = tuple[tuple[float, float] | None, ...]


@validated(ScenarioError)
class PlanarArm(Record):
    """A planar arm with its base at the origin; joints turn counter-clockwise from the link before them."""

    link_lengths_m: Annotated[tuple[Length, ...], Field(min_length=1)] = (2.0, 2.0)
    half_width_m: Length = 0.1
    joint_limits_rad: JointLimits | None = None  # (low, high), at any turn; None for circles

    def __post_init__(self) -> None:
        limits = self.joint_limits_rad or (None,) * self.dim
        if len(limits) != self.dim or not all(lim is None or is_range(*lim) for lim in limits):
            expected = f"{self.dim} entries, each None or low < high, {MIN_RANGE_RAD} rad or more"
            raise ScenarioError("the joint limits do not fit", expected=expected, got=str(limits))

    @property
    def dim(self) -> int:
        return len(self.link_lengths_m)

    @property
    def space(self) -> JointSpace:
        limits = self.joint_limits_rad or (None,) * self.dim
        return JointSpace(
            tuple(-np.pi if lim is None else lim[0] for lim in limits),
            tuple(np.pi if lim is None else lim[1] for lim in limits),
            tuple(lim is None for lim in limits),
        )

    def joint_positions_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to (N, d + 1, 2) m, the base first, the tip last."""
        heading = np.cumsum(np.atleast_2d(np.asarray(configurations, dtype=np.float64)), axis=1)
        steps = (
            np.stack([np.cos(heading), np.sin(heading)], axis=-1) * np.asarray(self.link_lengths_m)[:, None]
        )
        base = np.zeros((heading.shape[0], 1, 2))
        return np.concatenate([base, np.cumsum(steps, axis=1)], axis=1)

    def to_dict(self) -> dict[str, Any]:
        return {"kind": _KIND, **Record.to_dict(self)}

    @classmethod
    def from_dict(cls, values: object) -> "PlanarArm":
        """The inverse of :meth:`to_dict`; kind and limits may be missing."""
        usual = {"kind": _KIND, "joint_limits_rad": None}
        members = usual | read_object(dict[str, Any], values, "the robot", ScenarioError)
        if (kind := members.pop("kind")) != _KIND:
            raise ScenarioError("the robot is unknown", expected=_KIND, got=repr(kind)[:200])
        return read_object(cls, members, "the robot", ScenarioError)


def link_offsets_m(joints: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """From the nearest point on each link's axis (k, d + 1, 2) m to places (n, 2) m, (k, d, n, 2) m."""
    begins = joints[:, :-1, None]
    along = joints[:, 1:, None] - begins
    offsets = places - begins
    shares = np.clip((offsets * along).sum(axis=-1) / (along * along).sum(axis=-1), 0.0, 1.0)
    found: NDArray[np.float64] = offsets - shares[..., None] * along
    return found


TWO_LINK = PlanarArm()
THREE_LINK = PlanarArm(link_lengths_m=(1.6, 1.4, 1.0))
