"""The data-set folder: pictures, free configurations and more as memory-mappable arrays beside a manifest.

| file | array |
|---|---|
| ``images.npy`` | (S, P, P, 3) uint8, one picture a scenario |
| ``free.npy``, ``free_offsets.npy`` | (M, d) float32 rad; scenario i owns rows offsets[i]:offsets[i+1] |
| ``collision.npy``, ``collision_offsets.npy`` | the same for configurations in collision, optional |
| ``free_clearance.npy``, ``collision_clearance.npy`` | (M,) float32 m, of each of their rows, optional |
| ``free_origin.npy``, ``collision_origin.npy`` | (M,) uint8, places in cspace.workshop.ORIGINS, optional |
| ``paths.npy``, ``path_offsets.npy``, ``path_scenario.npy`` | (T, d), rows of a path, scenario; optional |
| what the world names | the geometry of the scenarios, where it is known; planar: ``discs.npy``, (S, D, 3) |
| ``extra_images.npy`` | (E, P, P, 3) uint8, pictures without configurations; optional |
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.dataset.checks import TOLD, check_arrays
from cspace.dataset.manifest import MANIFEST_FILE, Manifest, file_digest
from cspace.errors import DamagedFileError, DatasetError, StorageError
from cspace.files import make_output_folder, replacing
from cspace.npy import map_npy
from cspace.space import JointSpace
from cspace.world import World

REQUIRED = ("images", "free", "free_offsets")
OPTIONAL = (
    *("collision", "collision_offsets", "paths", "path_offsets", "path_scenario", "extra_images"),
    *TOLD,
)
# Room that stays free on the disk after a data set has been written.
RESERVE_BYTES = 256 * 2**20

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Dataset:
    """An opened data set; its arrays are memory-mapped and read-only.

    Args:
        folder: where it lies.
        manifest: its description.
        arrays: by file name without ending.
    """

    folder: Path
    manifest: Manifest
    arrays: Arrays

    @property
    def world(self) -> World:
        """Robot and sensor."""
        return self.manifest.world

    @property
    def digest(self) -> str:
        """SHA-256 over the content."""
        return self.manifest.digest

    @property
    def dim(self) -> int:
        """Number of joints."""
        return self.world.dim

    @property
    def scenario_count(self) -> int:
        """S."""
        return len(self.images)

    @property
    def images(self) -> NDArray[np.uint8]:
        """(S, P, P, 3)."""
        return self.arrays["images"]

    @property
    def free(self) -> NDArray[np.float32]:
        """(M, d) rad."""
        return self.arrays["free"]

    @property
    def free_offsets(self) -> NDArray[np.int64]:
        """(S + 1,)."""
        return self.arrays["free_offsets"]

    @property
    def collision(self) -> NDArray[np.float32] | None:
        """(M', d) rad."""
        return self.arrays.get("collision")

    @property
    def collision_offsets(self) -> NDArray[np.int64] | None:
        """(S + 1,)."""
        return self.arrays.get("collision_offsets")

    @property
    def extra_images(self) -> NDArray[np.uint8] | None:
        """(E, P, P, 3)."""
        return self.arrays.get("extra_images")

    @property
    def generator_seed(self) -> int | None:
        """The seed of generated scenarios, None for somebody's own data."""
        seed = self.manifest.generator.get("seed")
        return seed if isinstance(seed, int) else None

    def free_of(self, scenario: int) -> NDArray[np.float32]:
        """Free configurations of one scenario, (n, d) rad."""
        return self.free[self.free_offsets[scenario] : self.free_offsets[scenario + 1]]

    def collision_of(self, scenario: int) -> NDArray[np.float32]:
        """Configurations in collision of one scenario, (n, d) rad.

        Raises:
            DatasetError: the data set holds none.
        """
        if self.collision is None or self.collision_offsets is None:
            raise DatasetError("the data set holds no configurations in collision", got=str(self.folder))
        return self.collision[self.collision_offsets[scenario] : self.collision_offsets[scenario + 1]]

    @property
    def told(self) -> tuple[str, ...]:
        """Names of the arrays that tell more of each configuration."""
        return tuple(name for name in TOLD if name in self.arrays)

    def told_of(self, name: str, scenario: int) -> NDArray[Any]:
        """One of :attr:`told` for one scenario's configurations, (n,)."""
        offsets = self.arrays[f"{name.partition('_')[0]}_offsets"]
        return self.arrays[name][offsets[scenario] : offsets[scenario + 1]]


def open_dataset(folder: Path, *, verify: bool = True) -> Dataset:
    """Open a data-set folder.

    Args:
        folder: generated, imported or written by hand to the format.
        verify: whether every file's digest is computed and compared.

    Raises:
        DatasetError: the folder does not follow the format.
        DamagedFileError: a file's digest is not the manifest's; the file is named.
    """
    folder = Path(folder)
    manifest = Manifest.read(folder)
    for name, expected in manifest.files.items():
        path = folder / name
        if Path(name).name != name or not path.is_file():
            raise DamagedFileError(f"{path} is missing", expected="a file of the data set")
        if verify and (got := file_digest(path)) != expected:
            raise DamagedFileError(
                f"{path} is damaged", expected=f"SHA-256 {expected}", got=got, remedy="make or copy it again"
            )
    arrays = {Path(name).stem: map_npy(folder / name, DamagedFileError) for name in manifest.files}
    check_arrays(arrays, manifest.world, REQUIRED, OPTIONAL)
    return Dataset(folder, manifest, arrays)


def write_dataset(
    folder: Path,
    *,
    world: World,
    images: NDArray[np.uint8],
    free: Sequence[NDArray[Any]],
    collision: Sequence[NDArray[Any]] | None = None,
    told: Mapping[str, Sequence[NDArray[Any]]] | None = None,
    paths: Sequence[tuple[int, NDArray[Any]]] | None = None,
    scenes: Arrays | None = None,
    extra_images: NDArray[np.uint8] | None = None,
    generator: Mapping[str, Any],
) -> Dataset:
    """Write a data set beside its place and rename it, so that it appears whole or not at all.

    Args:
        folder: must not exist.
        world: robot and sensor.
        images: (S, P, P, 3).
        free: one (n_i, d) rad array a scenario.
        collision: the same for configurations in collision.
        told: what is told of each configuration, one (n_i,) array a scenario, by the file's name.
        paths: (scenario, waypoints (t, d) rad) each.
        scenes: the geometry of all scenarios, where it is known, as the world's arrays.
        extra_images: (E, P, P, 3).
        generator: how the data were made; JSON values.

    Raises:
        DatasetError: the arrays do not fit each other or the robot.
        StorageError: the folder exists, the disk is too full, or it cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {"images": images, **_rows("free", free, world.space)}
    if collision is not None:
        arrays |= _rows("collision", collision, world.space)
    arrays |= {name: np.concatenate(parts).astype(TOLD[name]) for name, parts in (told or {}).items()}
    if paths is not None:
        waypoints = _rows("paths", [path for _, path in paths], world.space)
        arrays |= {"paths": waypoints["paths"], "path_offsets": waypoints["paths_offsets"]}
        arrays["path_scenario"] = np.array([scenario for scenario, _ in paths], dtype=np.int64)
    arrays |= {name: np.asarray(array, dtype=np.float64) for name, array in (scenes or {}).items()}
    arrays |= {} if extra_images is None else {"extra_images": extra_images}
    check_arrays(arrays, world, REQUIRED, OPTIONAL)
    counted = (name for name in arrays if not name.endswith("_offsets") and name not in TOLD)
    counts = {name: len(arrays[name]) for name in counted}
    _write(Path(folder), arrays, Manifest(world, counts, generator, {}))
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


def _write(folder: Path, arrays: Arrays, manifest: Manifest) -> None:
    if folder.exists():
        raise StorageError("the data set's folder exists", expected="a new folder", got=str(folder))
    require_room(folder, sum(array.nbytes for array in arrays.values()))
    with replacing(folder, f"the data set {folder}") as beside:
        make_output_folder(beside)
        files = {}
        for name, array in arrays.items():
            np.save(beside / f"{name}.npy", array, allow_pickle=False)
            files[f"{name}.npy"] = file_digest(beside / f"{name}.npy")
        whole = Manifest(manifest.world, manifest.counts, manifest.generator, files)
        (beside / MANIFEST_FILE).write_text(whole.to_json(), encoding="utf-8")


def _rows(name: str, parts: Sequence[NDArray[Any]], space: JointSpace) -> dict[str, NDArray[Any]]:
    """Parts of different length as one array and its offsets."""
    arrays, dim = [np.asarray(part) for part in parts], space.dim
    wrong = [array.shape for array in arrays if array.ndim != 2 or array.shape[1] != dim]
    if wrong:
        raise DatasetError(f"{name} does not fit the robot", expected=f"arrays (n, {dim})", got=str(wrong[0]))
    offsets = np.cumsum([0, *(len(array) for array in arrays)], dtype=np.int64)
    joined = np.concatenate(arrays) if arrays else np.empty((0, dim))
    if not np.isfinite(joined).all():
        raise DatasetError(
            f"{name} holds values that are not finite", expected="angles in rad", got="nan or inf"
        )
    taken = space.admitted(joined, f"{name} holds configurations outside the robot's limits", DatasetError)
    return {name: space.to_float32(taken), f"{name}_offsets": offsets}
