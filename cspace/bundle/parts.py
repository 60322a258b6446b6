"""The parts of a bundle's description: its random inputs and how it was made."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from cspace.errors import BundleIntegrityError

DISTRIBUTIONS = ("uniform", "normal")
MAX_NAME, MAX_AXES, MAX_SIZE = 64, 7, 4096
RESERVED_INPUTS = ("", "latent", "image", "map", "start", "goal")


@dataclass(frozen=True, slots=True)
class RandomInput:
    """One random input of the generator graph, drawn anew for every latent.

    Args:
        name: the graph's name for it.
        distribution: ``uniform`` in [low, high) or ``normal`` with mean 0 and variance 1.
        shape: its shape behind the axis of the latents.
        low: lower end of a uniform input, None for a normal one.
        high: upper end of a uniform input, None for a normal one.

    Raises:
        BundleIntegrityError: the fields do not fit each other.
    """

    name: str
    distribution: str
    shape: tuple[int, ...]
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        one_of("the distribution of a random input", self.distribution, DISTRIBUTIONS)
        bounds = (self.low, self.high)
        if self.distribution == "normal":
            fits = bounds == (None, None)
        else:
            fits = self.low is not None and self.high is not None and self.low < self.high
            fits = fits and math.isfinite(self.high or 0.0) and math.isfinite(self.low or 0.0)
        taken = self.name in RESERVED_INPUTS
        sizes = len(self.shape) <= MAX_AXES and all(1 <= size <= MAX_SIZE for size in self.shape)
        if taken or not fits or not sizes or len(self.name) > MAX_NAME:
            raise BundleIntegrityError(
                "a random input of the bundle does not fit",
                expected="a short name of its own, a small positive shape, finite low < high where uniform "
                "and none else",
                got=repr(self)[:200],
            )


@dataclass(frozen=True, slots=True)
class Provenance:
    """How a bundle was made; plain JSON values throughout.

    Args:
        git_commit: commit of the training code.
        git_dirty: whether the tree held changes beside that commit.
        data_digest: SHA-256 digest of the data set.
        seeds: seed of each stage.
        config: the whole training configuration.
        metrics: what was measured.
        created: ISO 8601 time in UTC.
        command: the command that made it.
    """

    git_commit: str | None = None
    git_dirty: bool | None = None
    data_digest: str | None = None
    seeds: Mapping[str, Any] = field(default_factory=dict)
    config: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    created: str | None = None
    command: str | None = None


def one_of(what: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise BundleIntegrityError unless ``value`` is one of ``allowed``."""
    if value not in allowed:
        raise BundleIntegrityError(f"{what} is unknown", expected=" or ".join(allowed), got=repr(value)[:200])
