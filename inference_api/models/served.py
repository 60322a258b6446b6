"""A loaded bundle with the name under which it answers."""

from dataclasses import dataclass

from cspace.bundle import Bundle
from services.registry.models.port import ModelVersion

PRETRAINED_VERSION = 0


@dataclass(frozen=True, slots=True)
class ServedModel:
    """A loaded bundle with the name under which it answers.

    Args:
        bundle: the bundle.
        name: of the registered model, or ``pretrained``.
        version: its number in the registry, 0 for the shipped model.
        alias: by which it was found, None when it was not.
        run_id: the training run, None for the shipped model.
        fallback: whether the shipped model stands in for a champion.
        confirmed: whether the registry, asked last, says that the alias stands for this version.
    """

    bundle: Bundle
    name: str
    version: int
    alias: str | None = None
    run_id: str | None = None
    fallback: bool = False
    confirmed: bool = True

    @classmethod
    def of(
        cls, bundle: Bundle, version: ModelVersion, alias: str | None, *, confirmed: bool = True
    ) -> "ServedModel":
        """A version of the registry."""
        return cls(bundle, version.name, version.number, alias, version.run_id or None, confirmed=confirmed)
