"""Discs that are known to stand in the plane: read, checked and drawn into pictures. NumPy alone."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cspace.errors import InputError
from cspace.strict_json import parse_json, read_object, validated
from cspace.world import CheckCancelled, Contact
from cspace.worlds.planar.arm import PlanarArm, link_offsets_m
from cspace.worlds.planar.camera import Camera, Length, Place
from cspace.worlds.planar.scenes import MAX_DISCS

_WHERE = "the planning scene"
# As :mod:`cspace.worlds.planar.render` draws discs, which is compiled; lines of a pixel that are looked at.
_RED, _LINES = (255.0, 0.0, 0.0), 8


@validated(InputError)
class _Disc:
    x_m: Place
    y_m: Place
    radius_m: Length


@validated(InputError)
class _Body:
    name: Annotated[str, Field(min_length=1, max_length=100)]
    disc: _Disc


@validated(InputError)
class _Scene:
    scene: Annotated[tuple[_Body, ...], Field(max_length=MAX_DISCS)]

    def __post_init__(self) -> None:
        names = [one.name for one in self.scene]
        if len(set(names)) < len(names):
            raise InputError("two discs of scene have one name", expected="a name each", got=str(names)[:200])


@dataclass(frozen=True, slots=True, eq=False)
class KnownDiscs:
    """See :class:`cspace.world.Known`."""

    arm: PlanarArm
    names: tuple[str, ...]
    discs: NDArray[np.float64]  # (D, 3) x, y, radius in m
    seen: NDArray[np.uint8]  # uint8 (P, P, 3), what the picture shows beside them

    @classmethod
    def read(cls, text: bytes, arm: PlanarArm, seen: NDArray[np.uint8]) -> "KnownDiscs":
        """Of JSON: ``scene`` lists ``name`` and ``disc``, which has ``x_m``, ``y_m`` and ``radius_m``."""
        try:
            values = parse_json(text)
        except ValueError as problem:
            raise InputError(f"{_WHERE} is not JSON", expected="JSON", got=str(problem)[:200]) from problem
        if isinstance(values, dict) and (others := ", ".join(sorted(set(values) - {"scene"}))[:200]):
            raise InputError(
                f"the planar world takes no {others}",
                expected="scene alone, of discs with names",
                got=others,
                remedy=f"leave {others} out, or name a model of an arm in space",
            )
        bodies = read_object(_Scene, values, _WHERE, InputError).scene
        rows = [(one.disc.x_m, one.disc.y_m, one.disc.radius_m) for one in bodies]
        return cls(
            arm, tuple(one.name for one in bodies), np.asarray(rows, dtype=np.float64).reshape(-1, 3), seen
        )

    @property
    def size_bytes(self) -> int:
        """See :class:`cspace.world.Known`."""
        return self.discs.nbytes + self.seen.nbytes + sum(map(len, self.names))

    def free(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """Which of (N, d) rad touch no disc: those that :mod:`cspace.worlds.planar.checks` finds free."""
        joints = self.arm.joint_positions_m(configurations)
        found = np.ones(len(joints), dtype=np.bool_)
        # One by one: all at once would take 100 MB.
        for disc in self.discs:
            found &= (self._gaps(link_offsets_m(joints, disc[None, :2]), disc[2]) > 0.0).all(axis=(1, 2))
            check_cancelled()
        return found

    def certain(
        self, configurations: NDArray[np.floating], check_cancelled: CheckCancelled = lambda: None
    ) -> NDArray[np.bool_]:
        """None: other discs than the known ones are seen."""
        check_cancelled()
        return np.zeros(len(configurations), dtype=np.bool_)

    def contact(self, configuration: NDArray[np.floating]) -> Contact | None:
        """Where a configuration (d,) rad is deepest in a disc; None where it touches none."""
        offsets = link_offsets_m(self.arm.joint_positions_m(configuration), self.discs[:, :2])[0]
        gaps = self._gaps(offsets, self.discs[:, 2])
        link, disc = np.unravel_index(np.argmin(gaps), gaps.shape)
        if gaps[link, disc] > 0.0:
            return None
        x, y = (self.discs[disc, :2] - offsets[link, disc]).tolist()
        return Contact("known", f"link {link + 1}", self.names[disc], (x, y, 0.0), -float(gaps[link, disc]))

    def drawn(self, camera: Camera, check_cancelled: CheckCancelled = lambda: None) -> NDArray[np.uint8]:
        """The picture with the discs in it, uint8 (P, P, 3)."""
        left, right, bottom, top = camera.extent_m
        columns = np.linspace(left, right, camera.pixels + 1)
        lines = top - (np.arange(camera.pixels * _LINES) + 0.5) * (top - bottom) / (camera.pixels * _LINES)
        picture = self.seen.astype(np.float64)
        for x, y, radius in self.discs:
            chords = np.sqrt(np.maximum(radius**2 - (lines - y) ** 2, 0.0)).reshape(-1, _LINES, 1)
            covered = np.zeros((camera.pixels, camera.pixels))
            for half in np.moveaxis(chords, 1, 0):
                ends = np.maximum(columns[:-1], x - half), np.minimum(columns[1:], x + half)
                covered += np.maximum(ends[1] - ends[0], 0.0)
            share = covered[..., None] / (_LINES * (columns[1] - columns[0]))
            picture += share * (np.asarray(_RED) - picture)
            check_cancelled()
        return np.asarray(np.floor(picture + 0.5), dtype=np.uint8)

    def _gaps(
        self, offsets: NDArray[np.float64], radii: NDArray[np.float64] | np.float64
    ) -> NDArray[np.float64]:
        """Between links and discs, m."""
        return np.asarray(np.linalg.norm(offsets, axis=-1) - radii - self.arm.half_width_m)
