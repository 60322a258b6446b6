"""A registry in memory, with what the API needs of one and the faults that it must survive."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from cspace.bundle import Bundle
from cspace.errors import ModelNotFoundError, RegistryUnavailableError
from services.registry.models import ModelVersion

MODEL = "cspace-sampler"


class FakeRegistry:
    """Versions of models; counts what it is asked."""

    def __init__(self) -> None:
        self.away = False
        self.asked = 0
        self.downloads = 0
        self._versions: dict[tuple[str, int], tuple[ModelVersion, Path]] = {}

    def add(
        self, bundle: Path, *aliases: str, name: str = "cspace-sampler", digest: str | None = None
    ) -> int:
        """Register a bundle as the next version and return its number."""
        number = 1 + sum(key[0] == name for key in self._versions)
        digest = Bundle.load(bundle).digest if digest is None else digest
        version = ModelVersion(
            name=name,
            number=number,
            run_id=f"run-{number}",
            digest=digest,
            aliases=(),
            tags={},
            created_ms=number,
        )
        self._versions[name, number] = (version, bundle)
        for alias in aliases:
            self.move(alias, number, name)
        return number

    def move(self, alias: str, number: int | None, name: str = MODEL) -> None:
        """Move an alias to a version, or drop it."""
        for key, (version, bundle) in self._versions.items():
            if key[0] == name:
                others = tuple(item for item in version.aliases if item != alias)
                aliases = (*others, alias) if key[1] == number else others
                self._versions[key] = (replace(version, aliases=aliases), bundle)

    def clear(self) -> None:
        """Forget everything, as a registry that was set up anew."""
        self._versions.clear()

    def version(self, name: str, number: int) -> ModelVersion:
        self._answer()
        if (name, number) not in self._versions:
            raise ModelNotFoundError("no such version", got=f"{name}/{number}")
        return self._versions[name, number][0]

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        self._answer()
        for key, (version, _) in self._versions.items():
            if key[0] == name and alias in version.aliases:
                return version
        raise ModelNotFoundError("no such alias", got=f"{name}@{alias}")

    def versions(self, name: str) -> Sequence[ModelVersion]:
        self._answer()
        return [version for key, (version, _) in self._versions.items() if key[0] == name]

    def download(self, version: ModelVersion, folder: Path) -> Path:
        self._answer()
        self.downloads += 1
        target = folder / "bundle"
        shutil.copytree(self._versions[version.name, version.number][1], target)
        return target

    def _answer(self) -> None:
        self.asked += 1
        if self.away:
            raise RegistryUnavailableError("the registry does not answer")
