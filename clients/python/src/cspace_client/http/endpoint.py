"""Requests to an inference API, apart from how they travel: shared by both clients."""

import base64
import math
from dataclasses import dataclass, field
from typing import Any

import httpx

from cspace_client.errors import ConfigError
from cspace_client.questions.question import Question
from cspace_client.retries import RetryPolicy

# Shorter than what the server keeps an idle connection for, so that it is the client that closes it.
LIMITS = httpx.Limits(max_connections=100, max_keepalive_connections=20, keepalive_expiry=45.0)


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where a client asks and how patiently.

    Args:
        url: of the API, for example ``http://127.0.0.1:8000``; a slash at its end is taken away.
        timeout_s: for each read and write, within what the policy's deadline leaves.
        connect_timeout_s: for connecting; ``timeout_s`` when None.
        policy: when a request is sent again, and when it is given up.
        api_key: sent as ``Authorization: Bearer``; None sends none.

    Raises:
        ConfigError: the address, a time limit or the key can not be.
    """

    url: str
    timeout_s: float
    connect_timeout_s: float | None
    policy: RetryPolicy
    api_key: str | None = field(repr=False)
    _headers: dict[str, str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        limits = (self.timeout_s, self.connect_s)
        if not all(0.0 < limit < math.inf for limit in limits):
            raise ConfigError(
                "the client's time limit is out of range", expected="above 0", got=f"{limits[0]}, {limits[1]}"
            )
        key = self.api_key
        if key is not None and not (key and key.isascii() and key.isprintable() and " " not in key):
            raise ConfigError("the API key can not be", expected="printable ASCII without spaces")
        object.__setattr__(self, "url", _checked(self.url))
        object.__setattr__(self, "_headers", _headers(self.url, key))

    @property
    def connect_s(self) -> float:
        """Time limit for connecting."""
        return self.timeout_s if self.connect_timeout_s is None else self.connect_timeout_s

    def timeout(self, spent_s: float) -> httpx.Timeout:
        """Time limits of an attempt, within what the deadline leaves."""
        left = max(self.policy.deadline_s - spent_s, 1e-3)
        # Half for the connection and half for TLS, which have this limit each: cut short by the deadline
        # itself, the awaited transport would leave a socket in the middle of its handshake open.
        return httpx.Timeout(min(self.timeout_s, left), connect=min(self.connect_s, 0.5 * left))

    def request(self, question: Question[Any], spent_s: float) -> httpx.Request:
        """A question as it is sent.

        Transports are given it as it is. A client of httpx would store a stranger's cookies and look at where
        he redirects to.
        """
        return httpx.Request(
            "POST",
            f"{self.url}{question.path}",
            headers=self._headers | {"Accept": f"{question.media_type}, application/problem+json"},
            data=question.fields,
            files=question.files,
            extensions={"timeout": self.timeout(spent_s).as_dict()},
        )


def _headers(url: str, key: str | None) -> dict[str, str]:
    """What every request carries; an address with a name and a password has them before the key."""
    headers = {
        # The body as it is: what unpacks it would decide how much memory an answer takes.
        "Accept-Encoding": "identity",
        "Connection": "keep-alive",
        "User-Agent": f"python-httpx/{httpx.__version__}",
    }
    parsed = httpx.URL(url)
    if parsed.username or parsed.password:
        pair = f"{parsed.username}:{parsed.password}".encode()
        headers["Authorization"] = f"Basic {base64.b64encode(pair).decode()}"
    elif key is not None:
        headers["Authorization"] = f"Bearer {key}"
    return headers


def _checked(url: str) -> str:
    try:
        parsed = httpx.URL(url)
    except (httpx.InvalidURL, TypeError) as error:
        raise _bad_url(url) from error
    if parsed.scheme not in ("http", "https") or not parsed.host or parsed.query or parsed.fragment:
        raise _bad_url(url)
    return url.rstrip("/")


def _bad_url(url: str) -> ConfigError:
    return ConfigError(
        "the sampling endpoint's address can not be",
        expected="http://host:port",
        got=repr(url),
        remedy="for example http://127.0.0.1:8000",
    )
