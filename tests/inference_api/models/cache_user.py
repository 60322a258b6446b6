"""``cache_user.py CACHE BUNDLE SEED ROUNDS``: loads and removes versions in a cache that others use."""

import shutil
import sys
from pathlib import Path

import numpy as np

from cspace.bundle.files import read_files
from inference_api.models.cache import BundleCache, DiskCache
from services.registry.entities import ModelVersion
from tests.fakes.registry import FakeRegistry


class Registry(FakeRegistry):
    """The bundle is the same for every version, and its sums tell whether it is whole."""

    def __init__(self, bundle: Path) -> None:
        self._bundle = bundle

    def download(self, version: ModelVersion, folder: Path) -> Path:
        return Path(shutil.copytree(self._bundle, folder))


def main() -> None:
    cache, bundle, seed, rounds = Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], int(sys.argv[4])
    chance = np.random.default_rng(int(seed))
    # One version is kept beside the newest, so that nearly every download takes another one away.
    disk = DiskCache(cache, stored=2)
    registry = Registry(bundle)
    digest = read_files(bundle).digest
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for _ in range(rounds):
        version = ModelVersion("m", int(chance.integers(1, 5)), "", digest, (), {}, 0)
        BundleCache(disk, registry, lambda folder, _: read_files(folder), 1).start(version).result(60.0)
        disk.remember_champion(version)
        if chance.random() < 0.2:
            disk.remove(version)


if __name__ == "__main__":
    main()
