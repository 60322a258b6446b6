"""The bundle whose encoder and validity head path models see with."""

from pathlib import Path

from cspace.bundle import Bundle
from cspace.errors import ConfigError
from services.registry.models.port import ModelRegistry, ModelVersion


def source_bundle(source: str, registry: ModelRegistry, folder: Path) -> Bundle:
    """A bundle's folder, or a registered version that is fetched.

    Args:
        source: a folder, ``name@alias`` or ``name/version``.
        registry: where versions are.
        folder: where a version is laid down; what a stopped job has left there is taken.

    Raises:
        ConfigError: it is neither.
        ModelNotFoundError: there is no such version.
        BundleError: the bundle is damaged.
    """
    if Path(source).is_dir():
        return Bundle.load(Path(source))
    if folder.is_dir():
        return Bundle.load(folder)
    return Bundle.load(registry.download(_version(source, registry), folder))


def _version(source: str, registry: ModelRegistry) -> ModelVersion:
    name, separator, alias = source.partition("@")
    if separator and name and alias:
        return registry.by_alias(name, alias)
    name, separator, number = source.rpartition("/")
    if separator and name and number.isdecimal():
        return registry.version(name, int(number))
    raise ConfigError(
        "the source of the path models is unknown",
        expected="a bundle's folder, name@alias or name/version",
        got=repr(source),
    )
