"""The bundle whose encoder and validity head path models see with."""

from pathlib import Path

from cspace.bundle import Bundle
from services.registry.models.port import ModelRegistry
from services.registry.references import ModelReference


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
    reference = ModelReference.parse_version(
        source, "the source of the path models is unknown", "a bundle's folder, name@alias or name/version"
    )
    return Bundle.load(registry.download(reference.look_up(registry), folder))
