"""The port to the model registry: numbered versions of a named model, aliases on them, and their bundles."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Protocol

from pydantic import ConfigDict, Field

# More than any description has. These hold where a version is read from a file or comes from another process.
_Text = Annotated[str, Field(max_length=20_000)]
_Count = Annotated[int, Field(ge=0, lt=2**53)]


@dataclass(frozen=True)
class ModelVersion:
    """One version of a registered model.

    Args:
        name: of the registered model.
        number: counts from 1 within the model.
        run_id: the run that made it.
        digest: SHA-256 of the bundle's ``SHA256SUMS``; empty for a version that somebody else registered.
        aliases: in alphabetical order.
        tags: all of them, the digest included.
        created_ms: milliseconds since 1970-01-01 UTC.
    """

    __pydantic_config__: ClassVar = ConfigDict(extra="forbid", strict=True, revalidate_instances="always")

    name: _Text
    number: _Count
    run_id: _Text
    digest: _Text
    aliases: tuple[_Text, ...]
    tags: Mapping[_Text, _Text]
    created_ms: _Count

    def __str__(self) -> str:
        return f"{self.name}/{self.number}"


class ModelReader(Protocol):
    """What serving asks a registry; with the errors of :class:`ModelRegistry`."""

    def version(self, name: str, number: int) -> ModelVersion:
        """One version by its number.

        Raises:
            ModelNotFoundError: there is none.
        """
        ...

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """The version that an alias points to.

        Raises:
            ModelNotFoundError: there is no such model or alias.
        """
        ...

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """All versions, newest first; empty for an unknown model."""
        ...

    def download(self, version: ModelVersion, folder: Path) -> Path:
        """Fetch a version's bundle, beside its place and renamed, so that it appears whole or not at all.

        Args:
            version: which.
            folder: where the bundle is to be; must not exist.

        Returns:
            The folder. Its content is as the registry has it; loading the bundle verifies it.

        Raises:
            ModelNotFoundError: there is no such version, or it holds no bundle.
            StorageError: the folder exists or cannot be written.
        """
        ...


@dataclass(frozen=True, slots=True)
class Shown:
    """What people see of a version once it is judged.

    Args:
        metrics: a few, by name.
        note: of its page, in Markdown.
        data: what it was judged on, in words.
        data_digest: of that, in hexadecimal.
    """

    metrics: Mapping[str, float]
    note: str
    data: str
    data_digest: str


class ModelRegistry(ModelReader, Protocol):
    """Where bundles become versions.

    Every method raises RegistryUnavailableError within seconds when the registry does not answer, and
    RegistryError for what it refuses.
    """

    def register(
        self,
        name: str,
        bundle_folder: Path,
        run_id: str,
        digest: str,
        tags: Mapping[str, str],
        *,
        alias: str | None = None,
    ) -> ModelVersion:
        """Make a bundle the next version of a model, which is created when it is new.

        The same digest from the same run is registered once: a second call returns the first version, with
        the tags and the alias set again. What :func:`services.names.world_tags` tells of the
        bundle's world is among the tags.

        Args:
            name: of the model.
            bundle_folder: as ``cspace.bundle.write_bundle`` leaves it.
            run_id: the run that made the bundle.
            digest: what the caller takes the bundle's digest to be.
            tags: lineage, such as the data digest and the preset.
            alias: moved to this version.

        Raises:
            BundleIntegrityError: the folder is damaged or has another digest.
            RegistryError: there is no such run.
        """
        ...

    def names(self) -> tuple[str, ...]:
        """The registered models, in alphabetical order."""
        ...

    def delete(self, name: str, number: int) -> None:
        """Delete a version for good; its number is not given again.

        Raises:
            ModelNotFoundError: there is no such version.
        """
        ...

    def set_alias(self, name: str, alias: str, number: int) -> None:
        """Point an alias to a version, away from whichever had it.

        Raises:
            ModelNotFoundError: there is no such version.
        """
        ...

    def set_tags(self, name: str, number: int, tags: Mapping[str, str]) -> None:
        """Set tags on a version; others stay.

        Raises:
            ModelNotFoundError: there is no such version.
        """
        ...

    def show(self, version: ModelVersion, shown: Shown) -> None:
        """Show figures and a note where people compare versions, in place of those shown before.

        The figures are told of the run that made the version, and of its logged model.

        Raises:
            ModelNotFoundError: there is no such version.
            RegistryError: its run was deleted.
        """
        ...

    def remove_tag(self, name: str, number: int, tag: str) -> None:
        """Take a tag off a version; nothing happens where it has none of this name.

        Raises:
            ModelNotFoundError: there is no such version.
        """
        ...
