"""The kinds of worlds, one folder each, and the one door to them."""

import json
from collections.abc import Mapping
from functools import lru_cache
from hashlib import sha256
from importlib import import_module
from typing import Any, Protocol, cast

from cspace.errors import ScenarioError
from cspace.workshop import Checker, Workshop
from cspace.world import Image, Scene, World

# Each folder has ``world`` (numpy alone) with ``read``, and ``workshop`` with ``open_workshop``.
KINDS = ("planar",)
# What files are of that do not name their kind: older than kinds are.
FIRST = "planar"


class _Reader(Protocol):
    EXAMPLES: Mapping[str, World]

    def read(self, values: Mapping[str, Any]) -> World: ...


class _Opener(Protocol):
    def open_workshop(self, world: World) -> Workshop: ...


def read_world(values: Mapping[str, Any]) -> World:
    """The inverse of :meth:`cspace.world.World.to_dict`.

    Raises:
        ScenarioError: the kind is unknown, or a value does not fit it.
    """
    kind = values.get("kind", FIRST)
    if kind not in KINDS:
        raise ScenarioError(
            "the world is unknown", expected=f"one of {', '.join(KINDS)}", got=repr(kind)[:200]
        )
    module = cast("_Reader", import_module(f"{__name__}.{kind}.world"))
    return module.read({key: value for key, value in values.items() if key != "kind"})


def examples() -> dict[str, World]:
    """Worlds that commands can name, of every kind; the first one where none is named."""
    found: dict[str, World] = {}
    for kind in KINDS:
        found |= cast("_Reader", import_module(f"{__name__}.{kind}.world")).EXAMPLES
    return found


def default_world() -> World:
    """The first of the examples."""
    return next(iter(examples().values()))


@lru_cache(maxsize=16)
def workshop_of(world: World) -> Workshop:
    """The workshop of a world; its kernels are loaded at the first call."""
    module = cast("_Opener", import_module(f"{__name__}.{world.kind}.workshop"))
    return module.open_workshop(world)


def robot_digest(world: World) -> str:
    """SHA-256 of the kind of a world and its robot, however it is seen."""
    told = {"kind": world.kind, "robot": world.body.to_dict()}
    return sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def checker_of(scene: Scene) -> Checker:
    """The collision checks of a scene."""
    return workshop_of(scene.world).checker(scene)


def picture_of(scene: Scene) -> Image:
    """The picture of a scene."""
    return workshop_of(scene.world).render(scene)


def picture_file_of(scene: Scene) -> bytes:
    """The same as a file."""
    return scene.world.sensor.encode(picture_of(scene))
