"""Many rows in parts of a fixed size, and a moment between two of them that belongs to whoever asked."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

# Bounds the memory of one call; a fixed size, so that it can not move a result.
CHUNK_ROWS = 4096

# May raise to stop the work.
Between = Callable[[], None]


def chunked(
    run: Callable[[slice], NDArray[np.float32]], rows: int, between: Between | None
) -> NDArray[np.float32]:
    """What ``run`` gives for all rows, in their order.

    Args:
        run: called with the rows of each part.
        rows: at least 1.
        between: called between two parts; what it raises passes through.
    """
    parts = []
    for at in range(0, rows, CHUNK_ROWS):
        if at and between is not None:
            between()
        parts.append(run(slice(at, at + CHUNK_ROWS)))
    return np.concatenate(parts)
