"""The words for an answer that can not be used; a server's own words reach a terminal as plain text."""

from cspace_client.errors import SamplerAnswerError

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
