"""What one message may bring beside its body, counted while it arrives."""

from inference_api.connections.limits import ConnectionLimits
from inference_api.connections.refusal import Refusal
from inference_api.problems import HEADERS_TOO_LARGE, MALFORMED_REQUEST, URI_TOO_LONG

# Chunks of a single byte bring five more each: ``1 CR LF x CR LF``.
BYTES_BESIDE_ONE = 8


class RefusedError(Exception):
    """Ends the parser's work; what it carries is the answer."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.detail)
        self.refusal = refusal


class MessageBounds:
    """Counts one message after the other: headers by what the parser hands over, the rest by what it is fed.

    The parser keeps a header to itself until it is whole, and says nothing at all of chunk extensions.

    Args:
        limits: that are counted against.
    """

    def __init__(self, limits: ConnectionLimits) -> None:
        self._limits = limits
        self._of_head = self._headers = self._fed = self._body = 0
        # Which part of which message arrives: it counts up at the end of each head and of each message.
        self.part = 0

    @property
    def in_head(self) -> bool:
        """Whether a head arrives, or is waited for."""
        return self.part % 2 == 0

    @property
    def untouched(self) -> bool:
        """Whether not a byte of this head has come, as far as it can be told."""
        return self.in_head and self._fed == self._of_head == 0

    def next_part(self) -> None:
        """The head, or the message, is complete."""
        self.part += 1
        self._fed = self._body = 0
        if self.in_head:
            self._of_head = self._headers = 0

    def target(self, size: int, whole: int) -> None:
        """A piece of the request's target; raises RefusedError."""
        self._of_head += size
        if whole > self._limits.target_bytes:
            raise RefusedError(
                Refusal(
                    URI_TOO_LONG,
                    f"the path is longer than {self._limits.target_bytes} bytes",
                    "send values in the body",
                )
            )

    def header(self, size: int) -> None:
        """A header or a trailer, of name and value together; raises RefusedError."""
        self._of_head += size
        self._headers += 1
        if self._of_head > self._limits.header_bytes or self._headers > self._limits.headers:
            raise self._too_large()

    def body(self, size: int) -> None:
        """A piece of the body."""
        self._body += size

    def fed(self, size: int) -> None:
        """The parser has got bytes that all belong to this part; raises RefusedError."""
        self._fed += size
        if self.in_head:
            if self._fed > self._limits.header_bytes + self._limits.target_bytes:
                raise self._too_large()
        elif self._fed - self._body > self._limits.header_bytes + BYTES_BESIDE_ONE * self._body:
            raise RefusedError(
                Refusal(
                    MALFORMED_REQUEST,
                    "trailers and chunk extensions are many times larger than the body",
                    "announce the body's length instead of sending chunks",
                )
            )

    def _too_large(self) -> RefusedError:
        limits = self._limits
        return RefusedError(
            Refusal(
                HEADERS_TOO_LARGE,
                f"more than {limits.headers} headers, or than {limits.header_bytes} bytes of them",
                "send fewer and shorter headers",
            )
        )
