"""What goes wrong, in one tree.

ClientError
├── ConfigError (also a ValueError)     an address, a time limit or a share that is impossible
├── SamplerError                        the server refused the request, or it cannot be sent
│   ├── SamplerModelError               the server has no such model
│   └── SamplerUnavailableError         the server does not answer
│       └── SamplerAnswerError          its answer cannot be used
└── PlanningError                       a planner was asked for something impossible
"""


class ClientError(Exception):
    """Base of every error of the package."""

    def __init__(
        self, what: str, *, expected: str | None = None, got: str | None = None, remedy: str | None = None
    ) -> None:
        self.what, self.expected, self.got, self.remedy = what, expected, got, remedy
        parts = [what, expected and f"expected {expected}", got and f"got {got}", remedy]
        super().__init__("; ".join(part for part in parts if part))

    @property
    def details(self) -> dict[str, str | None]:
        """All but what is wrong."""
        return {"expected": self.expected, "got": self.got, "remedy": self.remedy}


class ConfigError(ClientError, ValueError):
    """A client, or a share of samples, that is impossible."""


class SamplerError(ClientError):
    """The server refused a request, or the request cannot be sent."""


class SamplerModelError(SamplerError):
    """The server has no such model."""


class SamplerUnavailableError(SamplerError):
    """The server does not answer."""


class SamplerAnswerError(SamplerUnavailableError):
    """The server's answer cannot be used."""


class PlanningError(ClientError):
    """A planner was asked for something impossible."""
