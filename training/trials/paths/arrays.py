"""What the path trials read, from the data set and a bundle to the trials by way of the object store."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.dataset import Dataset
from cspace.errors import ConfigError
from cspace.grid_search import centres
from cspace.space import JointSpace
from cspace.world import World
from services.progress import Progress
from training.models.lookups.lookups import Scenes
from training.models.paths.samples import PathSamples, equal_paths
from training.models.ways.fields import WayFields, fields_to_store

_LOG = logging.getLogger("training")
# Pictures of more bytes stay on disk: those of space are a megabyte each.
HELD_BYTES = 2**28


@dataclass(frozen=True, slots=True)
class PathArrays:
    """Paths with what a bundle tells of their pictures.

    Args:
        world: robot and sensor.
        paths: (T, P, d) float32 rad, points at equal distances.
        ids: (T,) int64 scenario of each.
        mu: (S, L) float32.
        sigma: (S, L) float32.
        images: (S, ...) uint8, or the data set's folder, from which every node reads them where they are
            too large to be sent about.
        maps: (S, c, c) uint8, the validity head's confidence at the cells' centres in 255 steps; None where
            no model asks for it.
        fields: (T, 2, c, c) uint8, detour and progress of every path by :mod:`training.models.ways.fields`;
            None likewise.
    """

    world: World
    paths: NDArray[np.float32]
    ids: NDArray[np.int64]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]
    images: NDArray[np.uint8] | Path
    maps: NDArray[np.uint8] | None
    fields: NDArray[np.uint8] | None = None

    def samples(self) -> PathSamples:
        """Tensors for the modules; copied, for the shared arrays are read-only."""
        return PathSamples(*(torch.tensor(part) for part in (self.paths, self.ids, self.mu, self.sigma)))

    def scenes(self) -> Scenes:
        """The pictures for look-ups, copied, or mapped from the disk."""
        if isinstance(self.images, Path):
            # Mapped as its own, for torch warns of what cannot be written.
            mapped = np.load(self.images / "images.npy", mmap_mode="c")
            return Scenes(self.world, torch.from_numpy(mapped))
        return Scenes(self.world, torch.tensor(self.images))


def path_arrays(
    bundle: Bundle, dataset: Dataset, points: int, cells: int | None, penalty: float | None = None
) -> PathArrays:
    """Paths, latents and, with ``cells`` along each joint, maps of all scenarios.

    Args:
        bundle: that sees the pictures.
        dataset: with paths.
        points: of each path.
        cells: of the maps; None for none.
        penalty: of the ways whose fields go with the maps; None for none.

    Raises:
        ConfigError: the data set is of another robot or camera than the bundle, or a map is asked of a bundle
            without a validity head or of another number of joints than two.
        DatasetError: the data set holds no paths.
    """
    spec = bundle.spec
    if (dataset.world) != (spec.world):
        raise ConfigError(
            "the paths are of another robot or camera than the bundle",
            expected=str(spec.world),
            got=str(dataset.world),
        )
    if cells is not None and (spec.dim != 2 or not bundle.has_validity):
        raise ConfigError(
            "a density needs a map of two joints",
            expected="a bundle of two joints with a validity head",
            got=f"{spec.dim} joints, {'a' if bundle.has_validity else 'no'} head",
            remedy="leave density out of models",
        )
    paths, ids = equal_paths(dataset, points)
    images = dataset.images
    grid = None if cells is None else centres(spec.world.space, (cells, cells)).astype(np.float32)
    latents, maps = [], []
    with Progress("pictures", len(images), _LOG.info, "picture") as progress:
        for image in images:
            if grid is None:
                latents.append(bundle.encode(image))
            else:
                picture = bundle.prepare(image)
                latents.append(picture.encoding)
                maps.append(np.round(bundle.score(picture, grid) * 255.0).astype(np.uint8))
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    shown = None if cells is None else np.stack(maps).reshape(-1, cells, cells)
    fields = None
    if shown is not None and penalty is not None:
        fields = _fields(shown, paths, ids, spec.world.space, penalty)
    held = dataset.folder.absolute() if images.nbytes > HELD_BYTES else np.asarray(images)
    return PathArrays(dataset.world, paths, ids, mu, sigma, held, shown, fields)


def _fields(
    maps: NDArray[np.uint8],
    paths: NDArray[np.float32],
    ids: NDArray[np.int64],
    space: JointSpace,
    penalty: float,
) -> NDArray[np.uint8]:
    ways = WayFields(space, maps.shape[1], penalty)
    found = np.empty((len(ids), 2, *maps.shape[1:]), dtype=np.uint8)
    with Progress("ways", len(ids), _LOG.info, "path") as progress:
        for index, (path, owner) in enumerate(zip(paths, ids, strict=True)):
            found[index] = fields_to_store(ways.of(maps[owner] / 255.0, path[0], path[-1]))
            progress.advance()
    return found
