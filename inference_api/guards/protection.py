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
    """

    keys_file: Path | None = None
    max_in_flight: int = 64
    body_timeout_s: float = 30.0
    rate_per_s: float = 0.0
    rate_burst: int = 20
