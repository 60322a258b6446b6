"""Data sets: a folder of arrays with a manifest, written whole or not at all."""

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import DatasetError, StorageError
from cspace.files import (
    adapter_of,
    json_text,
    make_output_folder,
    map_npy,
    read_bounded,
    read_json,
    read_object,
    replacing,
    validated,
)
from cspace.space import JointSpace
from cspace.world import Arrays, World
from cspace.worlds import WorldField

# Of each configuration, free or in collision: how far it is from contact, and how it was drawn.
ATTRIBUTES: dict[str, type] = {
    f"{name}_{what}": dtype
    for name in ("free", "collision")
    for what, dtype in (("clearance", np.float32), ("origin", np.uint8))
}
SCHEMA_VERSION = 2
MANIFEST_FILE = "manifest.json"
# Of a data set with some hundred files it has some 100 KiB.
MAX_MANIFEST_BYTES = 16 * 2**20


@validated(DatasetError)
class Manifest:
    """A data set's description."""

    world: WorldField
    counts: Mapping[str, int]
    generator: Mapping[str, Any]
    files: Mapping[str, str]  # SHA-256 of each file by its name

    @property
    def digest(self) -> str:
        """One SHA-256 over the world and all files; two data sets with equal content share it."""
        content = {**self.world.to_dict(), "files": dict(self.files)}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def to_json(self) -> str:
        content = adapter_of(Manifest).dump_python(self)
        content |= {"schema_version": SCHEMA_VERSION, "digest": self.digest}
        return json_text(content)

    @classmethod
    def read(cls, folder: Path) -> "Manifest":
        path = folder / MANIFEST_FILE
        remedy = "see docs/data.md for the format, python -m training.data import for own data"
        data = read_bounded(path, MAX_MANIFEST_BYTES, DatasetError, remedy=remedy)
        members = read_json(data, str(path), DatasetError)
        if (version := members.pop("schema_version", None)) != SCHEMA_VERSION:
            raise DatasetError(
                f"{path} is of another schema",
                expected=f"schema_version {SCHEMA_VERSION}",
                got=repr(version)[:200],
                remedy="generate or import the data again with this release",
            )
        digest = members.pop("digest", None)
        manifest = read_object(cls, members, str(path), DatasetError)
        if manifest.digest != digest:
            raise DatasetError(f"{path} is damaged", expected=str(digest)[:200], got=manifest.digest)
        return manifest


def file_digest(path: Path) -> str:
    """SHA-256 of a file, read in blocks."""
    with path.open("rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


# Room that stays free on the disk after a data set has been written.
RESERVE_BYTES = 256 * 2**20


@dataclass(frozen=True)
class Dataset:
    """An opened data set; its arrays are memory-mapped and read-only."""

    folder: Path
    manifest: Manifest
    arrays: Arrays

    @property
    def world(self) -> World:
        return self.manifest.world

    @property
    def digest(self) -> str:
        return self.manifest.digest

    @property
    def scenario_count(self) -> int:
        return len(self.images)

    @property
    def images(self) -> NDArray[np.uint8]:  # (S, P, P, 3)
        return self.arrays["images"]

    @property
    def free(self) -> NDArray[np.float32]:  # (M, d) rad
        return self.arrays["free"]

    @property
    def free_offsets(self) -> NDArray[np.int64]:  # (S + 1,)
        return self.arrays["free_offsets"]

    @property
    def collision(self) -> NDArray[np.float32] | None:  # (M', d) rad
        return self.arrays.get("collision")

    @property
    def collision_offsets(self) -> NDArray[np.int64] | None:
        return self.arrays.get("collision_offsets")

    @property
    def extra_images(self) -> NDArray[np.uint8] | None:  # (E, P, P, 3)
        return self.arrays.get("extra_images")

    @property
    def generator_seed(self) -> int | None:
        seed = self.manifest.generator.get("seed")
        return seed if isinstance(seed, int) else None

    def free_of(self, scenario: int) -> NDArray[np.float32]:
        return self.free[self.free_offsets[scenario] : self.free_offsets[scenario + 1]]

    def collision_of(self, scenario: int) -> NDArray[np.float32]:
        if self.collision is None or self.collision_offsets is None:
            raise DatasetError("the data set holds no configurations in collision", got=str(self.folder))
        return self.collision[self.collision_offsets[scenario] : self.collision_offsets[scenario + 1]]


def open_dataset(folder: Path, *, verify: bool = True) -> Dataset:
    """Open a data-set folder. ``verify``: whether every file's digest is computed and compared."""
    folder = Path(folder)
    manifest = Manifest.read(folder)
    for name, expected in manifest.files.items():
        path = folder / name
        if Path(name).name != name or not path.is_file():
            raise DatasetError(f"{path} is missing", expected="a file of the data set")
        if verify and (got := file_digest(path)) != expected:
            raise DatasetError(
                f"{path} is damaged", expected=f"SHA-256 {expected}", got=got, remedy="make or copy it again"
            )
    arrays = {Path(name).stem: map_npy(folder / name, DatasetError) for name in manifest.files}
    return Dataset(folder, manifest, arrays)


def write_dataset(
    folder: Path,
    *,
    world: World,
    images: NDArray[np.uint8],
    free: Sequence[NDArray[Any]],
    collision: Sequence[NDArray[Any]] | None = None,
    attributes: Mapping[str, Sequence[NDArray[Any]]] | None = None,
    paths: Sequence[tuple[int, NDArray[Any]]] | None = None,
    scenes: Arrays | None = None,
    extra_images: NDArray[np.uint8] | None = None,
    generator: Mapping[str, Any],
) -> Dataset:
    """Write a data set beside its place and rename it, so that it appears whole or not at all.

    ``images``: (S, P, P, 3). ``free``: one (n_i, d) rad array a scenario; ``attributes``: one (n_i,) array a
    scenario, by the file's name. ``paths``: (scenario, waypoints (t, d) rad) each.
    """
    arrays: dict[str, NDArray[Any]] = {
        name: np.asarray(array, np.float64) for name, array in (scenes or {}).items()
    }
    world.check_scenes(arrays, len(images))
    arrays |= {"images": images} | ({} if extra_images is None else {"extra_images": extra_images})
    for name in {"images", "extra_images"} & set(arrays):
        found, shape = arrays[name], world.sensor.picture_shape
        if found.dtype != np.uint8 or found.shape[1:] != shape or not len(found):
            got = f"{found.dtype} {found.shape}"
            raise DatasetError(f"{name} do not fit", expected=f"uint8 (n, *{shape}), n above 0", got=got)
    for name, parts in (("free", free), ("collision", collision)):
        if parts is not None:
            arrays |= _rows(name, parts, world.space)
            if len(parts) != len(images):
                got = f"{len(parts)} and {len(images)}"
                raise DatasetError(f"{name}_offsets do not fit", expected="as many as images", got=got)
    arrays |= {
        name: np.concatenate(parts).astype(ATTRIBUTES[name]) for name, parts in (attributes or {}).items()
    }
    if paths is not None:
        waypoints = _rows("paths", [path for _, path in paths], world.space)
        owners = np.array([scenario for scenario, _ in paths], dtype=np.int64)
        if (owners >= len(images)).any():
            raise DatasetError("path_scenario does not fit", expected=f"below {len(images)}")
        arrays |= {
            "paths": waypoints["paths"],
            "path_offsets": waypoints["paths_offsets"],
            "path_scenario": owners,
        }
    counted = (name for name in arrays if not name.endswith("_offsets") and name not in ATTRIBUTES)
    counts = {name: len(arrays[name]) for name in counted}
    folder = Path(folder)
    if folder.exists():
        raise StorageError("the data set's folder exists", expected="a new folder", got=str(folder))
    require_room(folder, sum(array.nbytes for array in arrays.values()))
    with replacing(folder, f"the data set {folder}") as beside:
        make_output_folder(beside)
        files = {}
        for name, array in arrays.items():
            np.save(beside / f"{name}.npy", array, allow_pickle=False)
            files[f"{name}.npy"] = file_digest(beside / f"{name}.npy")
        manifest = Manifest(world, counts, generator, files)
        (beside / MANIFEST_FILE).write_text(manifest.to_json(), encoding="utf-8")
    return open_dataset(folder, verify=False)


def require_room(folder: Path, needed_bytes: int) -> None:
    """Raise StorageError unless the disk of ``folder`` has room for ``needed_bytes`` and a reserve."""
    existing = next(parent for parent in (folder, *folder.parents) if parent.exists())
    available = shutil.disk_usage(existing).free
    if available < needed_bytes + RESERVE_BYTES:
        raise StorageError(
            f"the disk of {folder} is too full",
            expected=f"{(needed_bytes + RESERVE_BYTES) / 2**20:.0f} MiB",
            got=f"{available / 2**20:.0f} MiB",
            remedy="free some room, or name another folder",
        )


def _rows(name: str, parts: Sequence[NDArray[Any]], space: JointSpace) -> dict[str, NDArray[Any]]:
    """Parts of different length as one array and its offsets."""
    arrays, dim = [np.asarray(part) for part in parts], space.dim
    wrong = [array.shape for array in arrays if array.ndim != 2 or array.shape[1] != dim]
    if wrong:
        raise DatasetError(f"{name} does not fit the robot", expected=f"arrays (n, {dim})", got=str(wrong[0]))
    offsets = np.cumsum([0, *(len(array) for array in arrays)], dtype=np.int64)
    joined = np.concatenate(arrays) if arrays else np.empty((0, dim))
    taken = space.admitted(joined, f"{name} holds configurations outside the robot's limits", DatasetError)
    return {name: space.to_float32(taken), f"{name}_offsets": offsets}
