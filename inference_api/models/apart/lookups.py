"""The registry's lookups in a child."""

from typing import Any

from cspace.errors import RegistryError, RegistryUnavailableError
from inference_api.models.apart.processes.child import Child
from inference_api.models.apart.processes.pipes import ChildError
from inference_api.models.version_files import from_values
from services.registry.models.port import ModelVersion

LOOKUP_S = 8.0


class RegistryApart:
    """The port :class:`services.registry.models.port.ModelLookups` on a child that holds the registry.

    Args:
        child: in the role of ``lookups``.
        limit_s: for one lookup.
    """

    def __init__(self, child: Child, limit_s: float = LOOKUP_S) -> None:
        self._child, self._limit_s = child, limit_s

    def version(self, name: str, number: int) -> ModelVersion:
        """One version by its number; see :meth:`services.registry.models.port.ModelLookups.version`."""
        return _version(self._ask("version", name=name, number=number))

    def by_alias(self, name: str, alias: str) -> ModelVersion:
        """The version of an alias; see :meth:`services.registry.models.port.ModelLookups.by_alias`."""
        return _version(self._ask("by_alias", name=name, alias=alias))

    def versions(self, name: str) -> tuple[ModelVersion, ...]:
        """All versions, newest first; see :meth:`services.registry.models.port.ModelLookups.versions`."""
        found = self._ask("versions", name=name)
        if not isinstance(found, list):
            raise _no_answer()
        return tuple(_version(one) for one in found)

    def _ask(self, job: str, **arguments: Any) -> Any:
        try:
            return self._child.call(job, arguments, self._limit_s)
        except ChildError as error:
            raise RegistryUnavailableError(
                "the model registry does not answer",
                expected=f"an answer within {self._limit_s:g} s",
                got=str(error),
                remedy="ask again in some seconds",
            ) from None


def _version(values: object) -> ModelVersion:
    try:
        return from_values(values)
    except ValueError:
        raise _no_answer() from None


def _no_answer() -> RegistryError:
    return RegistryError("the model registry answers what is no model version")
