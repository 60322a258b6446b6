"""What is known of the request that is being answered: gathered on the way, told at its end.

A context variable holds the record, so that whoever learns something writes it down in one line, threads that
a request hands its work to included.
"""

import re
import secrets
from contextvars import ContextVar, Token
from dataclasses import dataclass

REQUEST_ID = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)


@dataclass(slots=True)
class RequestRecord:
    """One request.

    Args:
        request_id: the client's, or one of the server's.
        client: name of the key that it came with.
        reason: name of the problem that was its answer.
        model: that answered, ``name/version``.
        n: samples asked for.
        seed: that was used.
        shortfall: samples that are missing.
    """

    request_id: str
    client: str | None = None
    reason: str | None = None
    model: str | None = None
    n: int | None = None
    seed: int | None = None
    shortfall: int | None = None


_CURRENT: ContextVar[RequestRecord | None] = ContextVar("request_record", default=None)


def begin(record: RequestRecord) -> Token[RequestRecord | None]:
    """Make a record the current one; :func:`end` takes what this returns."""
    return _CURRENT.set(record)


def end(token: Token[RequestRecord | None]) -> None:
    """Make the record before it the current one again."""
    _CURRENT.reset(token)


def current() -> RequestRecord | None:
    """The record of the request that is being answered, None outside of one."""
    return _CURRENT.get()


def note_client(name: str) -> None:
    """Write down whose key a request came with."""
    record = current()
    if record is not None:
        record.client = name


def note_reason(name: str) -> None:
    """Write down which problem is the answer."""
    record = current()
    if record is not None:
        record.reason = name


def choose_request_id(sent: str | None) -> str:
    """The client's id if it is 1 to 128 of ``A-Za-z0-9._-``, else a fresh one of 32 hexadecimal digits."""
    return sent if sent is not None and REQUEST_ID.fullmatch(sent) else secrets.token_hex(16)
