"""The bundle whose encoder and validity head path models see with."""

from pathlib import Path

from cspace.bundle import Bundle, BundleSpec
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError
from services.registry.models.port import ModelRegistry
from services.registry.references import ModelReference


def source_bundle(source: str, registry: ModelRegistry, folder: Path) -> Bundle:
    """A bundle's folder, or a registered version that is fetched.

    Args:
        source: an absolute path of a folder, ``name@alias`` or ``name/version``.
        registry: where versions are.
        folder: where a version is laid down; what a stopped job has left there is taken.

    Raises:
        ConfigError: it is neither.
        ModelNotFoundError: there is no such version.
        BundleError: the bundle is damaged.
        ServiceError: the worker process that verifies it does not start.
    """
    if Path(source).is_absolute():
        return load_verified(Path(source))
    if folder.is_dir():
        return Bundle.load(folder)
    reference = ModelReference.parse_version(
        source, "the source of the path models is unknown", "a bundle's folder, name@alias or name/version"
    )
    return load_verified(registry.download(reference.look_up(registry), folder))


def require_source(start: Path | None, source: Bundle) -> None:
    """See that the job whose weights path models start from saw with the same encoder and head.

    Raises:
        ConfigError: it saw with others.
    """
    for made in () if start is None else start.glob("bundles/*/bundle.json"):
        seen_with = BundleSpec.from_json(made.read_bytes()).provenance.config.get("source_digest")
        if seen_with != source.digest:
            raise ConfigError(
                "source is not that of start_from",
                expected=f"the bundle {seen_with}",
                got=source.digest,
                remedy="set source to the version that those path models see with",
            )
