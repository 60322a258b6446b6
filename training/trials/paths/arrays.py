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
from cspace.world import World
from services.progress import Progress
from training.models.lookups.lookups import Scenes
from training.models.paths.samples import PathSamples, equal_paths

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
    """

    world: World
    paths: NDArray[np.float32]
    ids: NDArray[np.int64]
    mu: NDArray[np.float32]
    sigma: NDArray[np.float32]
    images: NDArray[np.uint8] | Path

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


def require_world(bundle: Bundle, world: World) -> None:
    """See that paths are of the world that a bundle sees.

    Raises:
        ConfigError: the robot, the camera or the scenes are others.
    """
    if world != bundle.spec.world:
        raise ConfigError(
            "the paths are of another robot or camera than the bundle",
            expected=str(bundle.spec.world),
            got=str(world),
        )


def path_arrays(bundle: Bundle, dataset: Dataset, points: int) -> PathArrays:
    """Paths and latents of all scenarios.

    Args:
        bundle: that sees the pictures.
        dataset: with paths.
        points: of each path.

    Raises:
        ConfigError: the data set is of another robot or camera than the bundle.
        DatasetError: the data set holds no paths.
    """
    require_world(bundle, dataset.world)
    paths, ids = equal_paths(dataset, points)
    images = dataset.images
    latents = []
    with Progress("pictures", len(images), _LOG.info, "picture") as progress:
        for image in images:
            latents.append(bundle.encode(image))
            progress.advance()
    mu, sigma = (np.stack([getattr(one, name) for one in latents]) for name in ("mu", "sigma"))
    held = dataset.folder.absolute() if images.nbytes > HELD_BYTES else np.asarray(images)
    return PathArrays(dataset.world, paths, ids, mu, sigma, held)
