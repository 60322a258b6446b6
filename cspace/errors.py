"""The one tree of errors that the project raises, below :class:`CspaceError`."""


class CspaceError(Exception):
    """Base of every error of the project."""

    def __init__(
        self,
        what: str,
        *,
        expected: str | None = None,
        got: str | None = None,
        remedy: str | None = None,
    ) -> None:
        parts = [what]
        if expected is not None:
            parts.append(f"expected {expected}")
        if got is not None:
            parts.append(f"got {got}")
        if remedy is not None:
            parts.append(remedy)
        super().__init__("; ".join(parts))
        self.what = what
        self.expected = expected
        self.got = got
        self.remedy = remedy

    def __reduce__(self) -> tuple[object, ...]:
        # Ray sends errors between processes; the default would replay only the joined message.
        details = {"expected": self.expected, "got": self.got, "remedy": self.remedy}
        return (_rebuild, (type(self), self.what, details))


def _rebuild(kind: type[CspaceError], what: str, details: dict[str, str | None]) -> CspaceError:
    return kind(what, **details)


class InputError(CspaceError, ValueError):
    """A value that came from outside is wrong."""


class ConfigError(InputError):
    """A setting or a configuration key is unknown or wrong."""


class ImageError(InputError):
    """Bytes that are not an acceptable picture."""


class ScenarioError(InputError):
    """A robot, a scenario or a planning problem that cannot be."""


class OtherRobotError(InputError):
    """A model is of another robot than the one that is planned for."""


class DatasetError(InputError):
    """A data-set folder does not follow the format."""


class BundleError(CspaceError):
    """A bundle cannot be used."""


class BundleIntegrityError(BundleError):
    """A bundle's sums, schema or files are wrong."""


class GoldenMismatchError(BundleError):
    """A bundle answers its golden case differently here."""


class StorageError(CspaceError):
    """The disk is full or the target cannot be written."""


class RegistryError(CspaceError):
    """The model registry refused or failed."""


class RegistryUnavailableError(RegistryError):
    """The model registry does not answer."""


class ModelNotFoundError(RegistryError):
    """The registry has no such model, version or alias."""


class SamplerError(CspaceError):
    """The sampling endpoint refused a request."""


class SamplerModelError(SamplerError):
    """The sampling endpoint has no such model."""


class SamplerUnavailableError(SamplerError):
    """The sampling endpoint does not answer."""


class PlanningError(CspaceError):
    """A planner was asked for something impossible."""


class EvaluationError(CspaceError):
    """An evaluation cannot be computed from what it was given."""


class ServiceError(CspaceError):
    """A process of this machine is not as it should be."""


class PortTakenError(ServiceError):
    """A port that a service needs is held by somebody else."""


class JobError(CspaceError):
    """A job failed or cannot go on."""
