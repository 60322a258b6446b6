"""k-means over the configuration space, on the (cos, sin) embedding so that clusters respect the circle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from cspace.errors import ConfigError
from cspace.space import embed

_BLOCK = 100_000


@dataclass(frozen=True, slots=True)
class Clustering:
    """A partition of the configuration space.

    Args:
        centres: (k, 2 d) in the embedding.
        labels: (M,) cluster of each configuration.
    """

    centres: NDArray[np.float64]
    labels: NDArray[np.int64]

    @property
    def sizes(self) -> tuple[int, ...]:
        """Configurations in each cluster."""
        return tuple(int(n) for n in np.bincount(self.labels, minlength=len(self.centres)))


def cluster(configurations: NDArray[np.float32], count: int, fit_samples: int, seed: int) -> Clustering:
    """Partition (M, d) configurations into ``count`` clusters.

    Args:
        configurations: rad.
        count: k.
        fit_samples: rows that the centres are fitted on; all rows are labelled.
        seed: of the rows and of k-means.

    Raises:
        ConfigError: fewer configurations than clusters.
    """
    total = len(configurations)
    if total < count:
        raise ConfigError(
            "there are too few configurations to cluster",
            expected=f"at least {count}",
            got=str(total),
            remedy="lower clusters.count or raise data.free_per_scenario",
        )
    rng = np.random.default_rng(seed)
    rows = rng.choice(total, size=min(total, fit_samples), replace=False)
    model = KMeans(count, n_init=4, random_state=seed).fit(embed(configurations[rows]))
    labels = [
        model.predict(embed(configurations[start : start + _BLOCK])) for start in range(0, total, _BLOCK)
    ]
    return Clustering(
        np.asarray(model.cluster_centers_, dtype=np.float64), np.concatenate(labels).astype(np.int64)
    )
