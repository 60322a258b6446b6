"""The suite's fake of the registry, with counters and with the faults that the API must survive."""

from dataclasses import replace
from pathlib import Path

from cspace.bundle.files import read_files
from services.registry.entities import ModelVersion
from tests.fakes.registry import FakeRegistry

MODEL = "cspace-sampler"


class CountingRegistry(FakeRegistry):
    """Counts the questions and downloads that it is asked for."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.calls = 0
        self.downloads = 0

    def add(self, bundle: Path, *aliases: str, name: str = MODEL, digest: str | None = None) -> int:
        """Register a bundle as the next version, under a false digest if one is given; its number."""
        run_id = f"run-{len(self._versions.get(name, [])) + 1}"
        version = self.register(name, bundle, run_id, read_files(bundle).digest, {})
        if digest is not None:
            self._versions[name][version.number - 1] = replace(version, digest=digest)
        for alias in aliases:
            self.set_alias(name, alias, version.number)
        return version.number

    def drop_alias(self, alias: str, name: str = MODEL) -> None:
        """Take an alias away."""
        del self._aliases[name, alias]

    def start_again(self) -> None:
        """Forget everything, as a registry on an empty database."""
        self._versions.clear()
        self._aliases.clear()
        self._folder = self._folder / "again"

    def download(self, version: ModelVersion, folder: Path) -> Path:
        self.downloads += 1
        return super().download(version, folder)

    def _check_there(self) -> None:
        self.calls += 1
        super()._check_there()
