"""What a world is: a robot, how it is seen, and the scenes that it stands in.

A :class:`World` is a value: it stands in ``bundle.json`` and in a data set's manifest, needs numpy alone,
and is all that a server knows. What makes and checks scenes is a :class:`cspace.simulator.Simulator`. Kinds
of worlds are registered in :mod:`cspace.worlds`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cspace.errors import ConfigError
from cspace.space import JointSpace
from cspace.view_file import View

Image = NDArray[np.uint8]
Arrays = Mapping[str, NDArray[Any]]
# Called between the parts of long work; may raise to stop it, which passes through.
CheckCancelled = Callable[[], None]
# Codes of findings that servers act on.
ARM_IN_PICTURE, LITTLE_IN_REACH = "arm-in-picture", "little-in-reach"
# Of wrong poses and states: what names a cause, and those by which requests are refused.
CAUSES = frozenset(
    {
        "depth-unit",
        "quaternion-order",
        "inverted-pose",
        "body-frame",
        "opengl-frame",
        "transposed-rotation",
        "translation-unit",
        "upside-down",
    }
)
POSE_CODES = CAUSES | {"arm-elsewhere"}
# Above it a picture is unlike any of training.
_NOVEL = 0.999


class Sensor(Protocol):
    """How a scene is seen: every rule about a picture's numbers."""

    @property
    def pixels(self) -> int:
        """P, side of the pictures that models take."""

    @property
    def picture_shape(self) -> tuple[int, ...]:
        """Shape of one decoded picture, uint8."""

    @property
    def convention(self) -> dict[str, Any]:
        """What a bundle says of the pictures that its encoder takes."""

    @property
    def extent_m(self) -> tuple[float, float, float, float] | None:
        """Left, right, bottom and top of the plane that a picture shows; None where it shows none."""

    def to_network(self, images: Image) -> NDArray[np.float32]:
        """Pictures as a network takes them, their channels first: (..., H, W, C) to (..., C, H, W)."""

    def to_dict(self) -> dict[str, Any]: ...


class Body(Protocol):
    """The robot's geometry."""

    def __hash__(self) -> int:
        """Equal robots are one."""

    @property
    def dim(self) -> int: ...

    @property
    def space(self) -> JointSpace: ...

    def joint_positions_m(self, configurations: ArrayLike) -> NDArray[np.float64]:
        """Forward kinematics: (N, d) rad to the joints' places, the base first, the tip last, m."""

    def to_dict(self) -> dict[str, Any]: ...


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about a picture that makes answers from it worse or wrong; answers carry it as a warning."""

    code: str
    seen: str
    effect: str
    remedy: str
    pictures: tuple[int, ...] = ()  # numbers of those that it is about, from 0; none where of all

    @property
    def message(self) -> str:
        return f"{self.seen}: {self.effect}; {self.remedy}"


@dataclass(frozen=True, slots=True)
class Contact:
    """Why a configuration is not free."""

    # `known` body, `self`, `seen` surface, or space that is `hidden` behind a surface, `unread`, or `out of
    # view`
    kind: str
    link: str
    other: str
    position_m: tuple[float, float, float]
    depth_m: float  # how deep, 0 or more; 0 for space that nobody saw

    @property
    def text(self) -> str:
        place = ", ".join(f"{value:.3f}" for value in self.position_m)
        what = {
            "seen": "touches a surface that a picture shows",
            "hidden": "is where a surface hides what is there",
            "unread": "is where the cameras read nothing",
            "out of view": "is out of view",
        }.get(self.kind, f"touches {self.other}")
        deep = f" by {1e3 * self.depth_m:.0f} mm" if self.depth_m > 0.0 else ""
        return f"{self.link} {what}{deep} at ({place}) m"


class Known(Protocol):
    """What is known of a scene beside its pictures."""

    def free(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad touch nothing that is known; ``check_cancelled`` is called between parts."""

    def certain(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad are free by what is known alone, so that there is nothing to predict."""

    @property
    def size_bytes(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    """Pictures that were read, and what is to be said of them."""

    images: Image  # (b, ...)
    findings: tuple[Finding, ...] = ()
    without_state: bool = False  # whether it is not known where the robot stands in them
    known: Known | None = None  # beside the pictures; None where they are all
    pictures: int = 1


@dataclass(frozen=True, slots=True)
class SuggestedPose:
    """Where a camera seems to stand instead of where it was said to."""

    picture: int  # number of its picture, from 0
    pose: tuple[tuple[float, ...], ...]  # rows of a 4 x 4 matrix, of the optical frame in the base frame, m
    offset_m: float
    turn_deg: float


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What a close look at pictures finds."""

    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    poses: tuple[SuggestedPose, ...] = ()

    def with_novelty(self, novelty: float | None) -> "Diagnosis":
        """With how unlike a model's training the pictures are, 0 to 1; None where no model tells."""
        if novelty is None:
            return self
        seen = f"the view is more unusual than {novelty:.0%} of the pictures of training"
        if novelty < _NOVEL:
            return replace(self, notes=(*self.notes, seen))
        effect = "the model answers by what it has learned of other views"
        remedy = "mend what else was found, or train for such cameras and scenes"
        return replace(self, findings=(*self.findings, Finding("novel", seen, effect, remedy)))


@dataclass(frozen=True, slots=True, eq=False)
class LinkSamplePoints:
    """Where pictures are read: (cos, sin) of the links' directions times ``offsets``, plus ``origin``."""

    offsets: NDArray[np.float32]  # (2 d, 2 K) float32
    origin: NDArray[np.float32]  # (2 K,) float32, shares of the picture's width, then of its height


@dataclass(frozen=True, slots=True, eq=False)
class GridArm:
    """A serial arm as spheres on a chain of d joints, and the grid of its pictures; frame 0 is the base."""

    origins: NDArray[np.float64]  # (d, 4, 4) of each joint in the frame before it, m
    axes: NDArray[np.float64]  # (d, 3) unit vectors that joints turn about
    spheres_m: NDArray[np.float64]  # (S, 4) centres in their frames, and radii
    own_radii_m: NDArray[np.float64]  # (S,) of the same spheres, by which they are held apart from each other
    links: NDArray[np.int64]  # (S,) the frame of each sphere
    # Pairs of sets of spheres, numbers (a,) and (b,), that must not touch each other
    touching: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]
    group_spheres_m: NDArray[np.float64]  # (G, 4), each of which holds a group of spheres
    group_links: NDArray[np.int64]  # (G,) their frames
    members: NDArray[np.int64]  # (G, most) spheres of each group, the first repeated behind the last
    low_m: NDArray[np.float64]  # (3,) lowest corner of the grid in the base frame
    voxel_m: float
    distance_step_m: float
    no_reading: int  # code of the second channel; 0 is seen free, what is between is behind a surface


class World(ABC):
    """A robot and how it is seen; each kind is a frozen dataclass of these fields."""

    __slots__ = ()
    kind: ClassVar[str]
    body: Body
    sensor: Sensor
    scenes: Any  # where they come from: a family, or given ones; None where nobody knows
    scene_files: ClassVar[tuple[str, ...]]  # a data set's arrays that hold scenes

    @property
    def space(self) -> JointSpace:
        return self.body.space

    @property
    def dim(self) -> int:
        return self.body.dim

    @property
    def motion_limits(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Largest velocities (d,) rad/s and accelerations (d,) rad/s^2, where they are known."""
        return None, None

    def read_picture(self, data: bytes | View) -> Image:
        """An untrusted picture, or several with their cameras, as the array that models take."""
        return np.asarray(self.examine_picture(data).images[0])

    @abstractmethod
    def examine_picture(self, data: bytes | View, check_cancelled: CheckCancelled = lambda: None) -> Examined:
        """:meth:`read_picture`, one image, with its findings."""

    def diagnosis(self, data: bytes | View, check_cancelled: CheckCancelled = lambda: None) -> Diagnosis:
        """A closer look at a picture than :meth:`examine_picture` takes, some 100 ms."""
        self.examine_picture(data, check_cancelled)
        return Diagnosis()

    def least_novelty(self, image: Image) -> float:
        """How novel a picture is at least, 0 to 1, whatever a model holds of it: 1 where it shows nothing."""
        del image
        return 0.0

    def state_findings(
        self,
        *,
        image: Image | None = None,
        start: ArrayLike | None = None,
        colliding: float = 0.0,
    ) -> tuple[Finding, ...]:
        """What an answer to pictures without the robot's state shows of a state that is missing."""
        del image, start, colliding
        return ()

    @abstractmethod
    def contact(
        self, configuration: NDArray[np.floating], image: Image, known: Known | None
    ) -> Contact | None:
        """What is in the way of a configuration (d,) rad, or unseen about it; None where nothing is."""

    def link_sample_points(self, points_per_link: int, side_m: float) -> LinkSamplePoints:
        """Where K points of the robot lie in its pictures, in rows ``side_m`` beside each link."""
        raise ConfigError(
            f"pictures of the {self.kind} world are not read along links",
            got=f"{points_per_link} points a link, {side_m} m beside it",
        )

    def grid_arm(self, groups: int) -> GridArm:
        """What a network that reads arrays of space has to know of the robot."""
        raise ConfigError(f"pictures of the {self.kind} world are no arrays of space", got=f"{groups} groups")

    @abstractmethod
    def check_scenes(self, arrays: Arrays, count: int) -> None:
        """Check those of the arrays that hold scenes."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]: ...


class Scene(Protocol):
    """A robot among obstacles, seen by a sensor."""

    @property
    def world(self) -> World: ...
