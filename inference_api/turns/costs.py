"""What requests cost, in rows: one is a sample that is drawn, or what takes as long.

:func:`rows_of` tells in advance what a request may cost, by which it is long or not. What a client pays for
is the time that its requests have computed.
"""

from cspace.bundle.keeping import BUDGET, BUDGET_AT_LEAST
from cspace.bundle.spec import BundleSpec
from cspace.query import SampleQuery

# Of the shipped model on a core of a server.
ROWS_A_SECOND = 50_000.0
# What a request costs before more is known of it, and above what it is long.
USUAL_ROWS, LONG_ROWS = 320.0, 4096.0
# So much of a request goes before the rest of longer ones: a plan ends soon beside plans that go on for long.
YOUNG_ROWS = 8192.0
# Others have their turns after so much computing.
STINT_S = 0.01
# So much takes as long as a row: JSON that is parsed, pixels that are decoded, values of an array.
_JSON_BYTES, _PIXELS, _VALUES = 150, 400, 100


def rows_of(
    *, drawn: float = 0, json_bytes: int = 0, pixels: int = 0, values: int = 0, searches: bool = False
) -> float:
    """What a request, or a part of one, may cost at most.

    Args:
        drawn: samples, or configurations that are scored.
        json_bytes: to be parsed.
        pixels: of pictures that are not known yet.
        values: of the arrays that these become.
        searches: a search lasts as long as its client wants: it is long.
    """
    parts = drawn + json_bytes / _JSON_BYTES + pixels / _PIXELS + values / _VALUES
    return parts + (LONG_ROWS + 1.0 if searches else 0.0)


def drawn_for(spec: BundleSpec, query: SampleQuery) -> int:
    """How many samples a request may draw for one picture."""
    threshold = spec.confidence_threshold if query.min_confidence is None else query.min_confidence
    return max(BUDGET * query.n, BUDGET_AT_LEAST) if threshold else query.n
