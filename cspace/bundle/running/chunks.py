"""Many rows in parts of a fixed size, and a moment between two of them that belongs to whoever asked."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

# Bound the memory and the time of one call; fixed sizes, so that they can not move a result. What one call
# of a path sampler draws comes in the order of the way, so it is drawn in larger parts.
CHUNK_ROWS, PATH_CHUNK_ROWS = 512, 4096

# May raise to stop the work.
Between = Callable[[], None]


def chunked(
    run: Callable[[slice], NDArray[np.float32]],
    rows: int,
    between: Between | None,
    chunk_rows: int = CHUNK_ROWS,
) -> NDArray[np.float32]:
    """What ``run`` gives for all rows, in their order.

    Args:
        run: called with the rows of each part.
        rows: at least 1.
        between: called between two parts; what it raises passes through.
        chunk_rows: of each part but the last.
    """
    parts = []
    for at in range(0, rows, chunk_rows):
        if at and between is not None:
            between()
        parts.append(run(slice(at, at + chunk_rows)))
    return np.concatenate(parts)
