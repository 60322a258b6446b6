"""What the sampler and the store of models tell whoever watches them."""

from dataclasses import dataclass
from typing import Literal, get_args

# Why a champion is not put into service: its bundle is damaged or not the registered one, its golden case
# gives other answers here, the registry is away, or the cache cannot be written.
Refusal = Literal["bundle", "golden", "registry", "storage"]
REFUSALS: tuple[Refusal, ...] = get_args(Refusal)


@dataclass(frozen=True, slots=True)
class Sampled:
    """A request for samples that was answered.

    Args:
        model: that answered, ``name/version``.
        fallback: whether the shipped model stood in for a champion.
        n: samples asked for.
        seed: that was used.
        shortfall: samples that are missing.
        acceptance: share of what was drawn that reached the confidence asked for, 0 to 1.
        stages_s: time by stage (decode, encode, generate, total), s.
    """

    model: str
    fallback: bool
    n: int
    seed: int
    shortfall: int
    acceptance: float
    stages_s: dict[str, float]


@dataclass(frozen=True, slots=True)
class Scored:
    """A question whether configurations are free that was answered.

    Args:
        model: that answered, ``name/version``.
        fallback: whether the shipped model stood in for a champion.
        n: configurations.
    """

    model: str
    fallback: bool
    n: int


@dataclass(frozen=True, slots=True)
class Planned:
    """A question for a way that was answered.

    Args:
        model: that answered, ``name/version``.
        fallback: whether the shipped model stood in for a champion.
        status: ``solved``, ``refused`` or ``timeout``.
        seed: that was used.
    """

    model: str
    fallback: bool
    status: str
    seed: int


class Observer:
    """Watches, and does nothing; what is called must be safe to call from several threads."""

    def scored(self, answer: Scored) -> None:
        """Configurations were scored."""

    def planned(self, answer: Planned) -> None:
        """A question for a way was answered."""

    def sampled(self, answer: Sampled) -> None:
        """A request for samples was answered."""

    def reloaded(self) -> None:
        """A champion was put into service."""

    def refused(self, reason: Refusal) -> None:
        """A champion was not put into service; the one before it stays."""
