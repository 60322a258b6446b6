"""The kinds of worlds, one folder each, and how they are found by kind."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import PlainSerializer, PlainValidator

from cspace.errors import InputError, ScenarioError
from cspace.files import read_object
from cspace.simulator import Checker, Simulator
from cspace.world import Body, Image, Known, Scene, World

# Each folder has ``world`` (NumPy alone) with ``read`` and ``EXAMPLES`` (worlds by name); ``simulator`` with
# ``open_simulator``; ``collision`` with ``seen_checkers``. One that no picture shows whole has ``benchmark``
# with ``open_partly_seen``; one whose robot has a tool ``constraints`` with ``ToolConstraints``.
KINDS = ("planar", "spatial")
_PARTLY_SEEN, WITH_TOOL = (
    tuple(kind for kind in KINDS if find_spec(f"{__name__}.{kind}.{part}"))
    for part in ("benchmark", "constraints")
)
# Of a robot that is the same one with others.
_MOTION = ("max_velocity_rad_s", "max_acceleration_rad_s2")
# What files are of that do not name their kind: older than kinds are.
FIRST = "planar"


def read_world(values: object) -> World:
    """The inverse of :meth:`cspace.world.World.to_dict`."""
    members = read_object(dict[str, Any], values, "the world", ScenarioError)
    kind = members.pop("kind", FIRST)
    if kind not in KINDS:
        raise ScenarioError(
            "the world is unknown", expected=f"one of {', '.join(KINDS)}", got=str(kind)[:200]
        )
    return cast("World", _part(kind, "world").read(members))


# A field of a pydantic model or dataclass.
WorldField = Annotated[
    World,
    PlainValidator(lambda value: value if isinstance(value, World) else read_world(value)),
    PlainSerializer(lambda world: world.to_dict(), return_type=Any),
]


def examples() -> dict[str, World]:
    """Worlds that commands can name, of every kind; the first one where none is named."""
    return {name: world for kind in KINDS for name, world in _part(kind, "world").EXAMPLES.items()}


def named_world(text: str) -> World:
    """The world of an example by its name, or of a robot's file."""
    known = examples()
    if text in known:
        return known[text]
    if not Path(text).is_file():
        raise ScenarioError(
            "the robot is unknown",
            expected=f"one of {', '.join(known)}, or a file that python -m training.robots import wrote",
            got=text[:200],
        )
    return cast("World", _part("spatial", "world").named(text))


def default_world() -> World:
    """The first of the examples."""
    return next(iter(examples().values()))


def part_types(part: str) -> tuple[type[Any], ...]:
    """The dataclasses of a part of worlds, ``body``, ``sensor`` or ``scenes``, of all kinds."""
    found = (one for kind in KINDS for one in _part(kind, "world").PARTS[part])
    return tuple(dict.fromkeys(found))


def usual_world(robot: Body, **parts: Any) -> World:
    """A robot that is seen, and stands in scenes, as those of its type usually are, but for given parts."""
    example: Any = next(world for world in examples().values() if type(world.body) is type(robot))
    own = {name: part for name, part in parts.items() if part is not None}
    return cast("World", replace(_part(example.kind, "world").usual(robot), **own))


@lru_cache(maxsize=16)
def simulator_of(world: World) -> Simulator:
    """The simulator of a world; its kernels are loaded at the first call."""
    return cast("Simulator", _part(world.kind, "simulator").open_simulator(world))


def partly_seen(world: World) -> Any:
    """Planning problems of a world that no picture shows whole, as ``SpatialPartlySeen``."""
    if world.kind not in _PARTLY_SEEN:
        raise ScenarioError("the world's pictures hide nothing", got=world.kind)
    return _part(world.kind, "benchmark").open_partly_seen(world)


def seen_checkers(
    world: World, picture: Image, ends: NDArray[np.float64], known: Known | None = None
) -> Sequence[Checker]:
    """Checks by what a picture shows, the most careful first; the robot is free at ``ends`` (k, d) rad."""
    found = _part(world.kind, "collision").seen_checkers(world, picture, ends, known=known)
    return cast("Sequence[Checker]", found)


def unseen_space(
    world: World,
    picture: Image,
    occupancy: NDArray[np.floating],
    ends: NDArray[np.float64],
    known: Known | None = None,
) -> Any:
    """The ``UnseenSpace`` of a model's occupancy, in which the robot has room at ``ends`` (k, d) rad."""
    return _part(world.kind, "occupancy").UnseenSpace(world, picture, occupancy, ends, known)


def load_known(world: World) -> None:
    """Have the compiled code of what is known beside pictures in this process, where a world's can be."""
    if world.kind in _PARTLY_SEEN:
        _part(world.kind, "scene_checker").load_kernels(world)


def tool_constraints(
    world: World, goal_pose: Mapping[str, Any] | None, upright: Mapping[str, Any] | None
) -> Any:
    """The ``ToolConstraints`` of a plan; None without any."""
    if goal_pose is None and upright is None:
        return None
    if world.kind not in WITH_TOOL:
        raise InputError(
            "the robot has no tool frame",
            expected=f"goal_pose and upright for worlds of the kind {', '.join(WITH_TOOL)} alone",
            got=f"a world of the kind {world.kind}",
            remedy="send goal as a configuration",
        )
    return _part(world.kind, "constraints").ToolConstraints(world.body, goal_pose, upright)


@lru_cache(maxsize=256)
def robot_digest(world: World) -> str:
    """SHA-256 of the kind of a world and its robot, however it is seen, stands and may move."""
    robot = {name: one for name, one in world.body.to_dict().items() if name not in _MOTION}
    content = {"kind": world.kind, "robot": robot}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def checker_of(scene: Scene) -> Checker:
    """The collision checks of a scene."""
    return simulator_of(scene.world).checker(scene)


def picture_file_of(scene: Scene) -> bytes:
    """The picture of a scene as a file."""
    return simulator_of(scene.world).picture_file(scene)


def _part(kind: str, name: str) -> Any:
    return import_module(f"{__name__}.{kind}.{name}")
