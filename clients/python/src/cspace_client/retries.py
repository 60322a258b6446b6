"""When a request is sent again: exponential backoff with full jitter, within a deadline. Pure."""

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime

from cspace_client.errors import ConfigError

_MAX_DIGITS = 9
_MAX_DATE = 64


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How often and how long.

    Args:
        attempts: requests in all, at least 1; 1 never sends a request again.
        base_s: bound of the first pause; it doubles from pause to pause.
        cap_s: largest bound of a pause.
        deadline_s: after the first attempt began no other begins, and the one that goes on is given up,
            however little it needs for each of its reads.

    Raises:
        ConfigError: a value is out of range.
    """

    attempts: int = 4
    base_s: float = 0.1
    cap_s: float = 2.0
    deadline_s: float = 30.0

    def __post_init__(self) -> None:
        times = (self.base_s, self.cap_s, self.deadline_s)
        if self.attempts < 1 or not all(0.0 < value < math.inf for value in times):
            raise ConfigError(
                "the client's retries are out of range", expected="1 attempt and 0 s or more", got=repr(self)
            )

    def pause_s(self, tried: int, spent_s: float, retry_after_s: float | None, draw: float) -> float | None:
        """The pause before the next attempt, None to give up.

        Full jitter spreads the clients that a server's pause has brought into step: the pause is uniform
        between 0 and min(cap, base 2^(tried - 1)).

        Args:
            tried: attempts so far, at least 1.
            spent_s: since the first one began.
            retry_after_s: what the server asks to wait at least.
            draw: uniform in [0, 1).
        """
        pause = draw * min(self.cap_s, self.base_s * 2.0 ** min(tried - 1, 64))
        pause = max(pause, retry_after_s or 0.0)
        return None if tried >= self.attempts or spent_s + pause >= self.deadline_s else pause


def parse_retry_after(value: str | None, now: datetime | None = None) -> float | None:
    """The header ``Retry-After`` (RFC 9110, 10.2.3) in s, 0 to infinity; None when absent or neither form.

    Args:
        value: seconds or an HTTP date.
        now: the time to which a date is compared; the clock's when None.
    """
    text = (value or "").strip()
    if text.isascii() and text.isdigit():
        # Longer than anybody waits; a caller gives up.
        return float(text) if len(text) <= _MAX_DIGITS else math.inf
    if len(text) > _MAX_DATE:
        return None
    try:
        date = parsedate_to_datetime(text)
        date = date if date.tzinfo else date.replace(tzinfo=UTC)
        return max(0.0, (date - (now or datetime.now(UTC))).total_seconds())
    # A year or a zone of many digits overflows.
    except (ValueError, OverflowError):
        return None
