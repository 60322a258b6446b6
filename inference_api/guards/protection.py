"""Settings of the guards."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Protection:
    """Who may ask, and how much.

    Args:
        keys_file: of API keys, see :mod:`inference_api.keys`; None lets everybody in.
        max_in_flight: requests that are answered at the same time, at least 1; further ones are refused.
        body_timeout_s: within which a request's body has to arrive, above 0.
        rate_per_s: requests a second and client that are allowed in the long run; 0 for no limit.
        rate_burst: how many a client may send at once before that counts, at least 1.
        held_body_bytes: of all bodies that have arrived and are not answered, above the largest body.
        hosts: names under which the server answers, besides those of loopback; ``*`` for any.
        origins: of other sites whose pages may use the server, as ``https://host:port``.
        trusted_proxies: addresses and networks whose ``X-Forwarded-For`` and ``-Proto`` are believed.
    """

    keys_file: Path | None = None
    max_in_flight: int = 64
    body_timeout_s: float = 30.0
    rate_per_s: float = 0.0
    rate_burst: int = 20
    held_body_bytes: int = 64 * 1024 * 1024
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()
    trusted_proxies: tuple[str, ...] = ()
