"""What goes wrong, in one tree, and the words for an answer that cannot be used.

ClientError
├── ConfigError (also a ValueError)     an address, a time limit, a key or a share that cannot be
├── SamplerError                        the server refused a request, or it cannot be sent
│   ├── SamplerModelError               the server has no such model
│   └── SamplerUnavailableError         the server does not answer
│       └── SamplerAnswerError          its answer cannot be used
├── LocalError                          nothing here draws from a bundle
└── PlanningError                       a planner was asked for something impossible
"""


class ClientError(Exception):
    """Base of every error of the package.

    Args:
        what: what is wrong, in one clause.
        expected: what would have been right.
        got: what came instead.
        remedy: what the reader can do.
    """

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
        self.what, self.expected, self.got, self.remedy = what, expected, got, remedy

    @property
    def details(self) -> dict[str, str | None]:
        """All but what is wrong."""
        return {"expected": self.expected, "got": self.got, "remedy": self.remedy}

    def __reduce__(self) -> tuple[object, ...]:
        # Pickle would replay the joined message alone.
        return (_rebuild, (type(self), self.what, self.details))


def _rebuild(kind: type[ClientError], what: str, details: dict[str, str | None]) -> ClientError:
    return kind(what, **details)


class ConfigError(ClientError, ValueError):
    """A client, or a share of samples, that cannot be."""


class SamplerError(ClientError):
    """The server refused a request, or the request cannot be sent."""


class SamplerModelError(SamplerError):
    """The server has no such model."""


class SamplerUnavailableError(SamplerError):
    """The server does not answer."""


class SamplerAnswerError(SamplerUnavailableError):
    """The server's answer cannot be used: as good as none."""


class LocalError(ClientError):
    """Nothing that is installed here draws from a bundle, or the bundle cannot be used."""


class PlanningError(ClientError):
    """A planner was asked for something impossible."""


MAX_CHARACTERS = 300
"""Of a server's words in an error's message."""


def printable(text: str, limit: int = MAX_CHARACTERS) -> str:
    """Text on one line, cut, with ``?`` for control characters, escapes, bidi controls and half characters.

    Args:
        text: from a stranger.
        limit: most characters of it, at least 1.
    """
    kept = text if len(text) <= limit else f"{text[: limit - 1]}…"
    # Exactly what Unicode calls other or a separator, the space apart, is not printable.
    return kept if kept.isprintable() else "".join(one if one.isprintable() else "?" for one in kept)


def unusable(what: str, expected: str, got: str) -> SamplerAnswerError:
    """The error of an answer that can not be used.

    Args:
        what: is wrong with it, as "has another seed".
        expected: what would have been right.
        got: what came instead, in whatever words; they are made printable.
    """
    return SamplerAnswerError(
        f"the sampling endpoint's answer {what}",
        expected=expected,
        got=printable(got),
        remedy="check that the address is an inference API of this release",
    )
