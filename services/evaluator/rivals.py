"""Whom a candidate is measured beside: the present champion, the best one before it, and the shipped model.

Other champions, and those whose bundles cannot be fetched, are compared by the metrics that they were
promoted with. A champion that was rolled back is not compared, unless it is the present one again.
"""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.errors import (
    BundleError,
    ConfigError,
    ModelNotFoundError,
    RegistryError,
    RegistryUnavailableError,
)
from cspace.world import World
from cspace.worlds import robot_digest, simulator_of
from services.evaluator.gate import SMALLER_IS_BETTER, Bar, Champion
from services.evaluator.scenes import PackedBundle
from services.names import ALIAS_CHAMPION, TAG_ROLLED_BACK
from services.registry.entities import SHIPPED, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import champions


@dataclass(frozen=True)
class Rival:
    """A model to be measured on the same scenes, whose world may have another camera.

    ``version`` is its number, None for the shipped model.
    """

    name: str
    world: World
    packed: PackedBundle
    version: int | None = None


def find_rivals(
    registry: ModelRegistry, version: ModelVersion, bundle: Bundle, shipped: Path | None, folder: Path
) -> tuple[tuple[Rival, ...], Bar]:
    """The rivals of a candidate's robot and kind to be measured, and the bar that lacks their comparisons.

    ``folder`` is for downloads; without ``shipped``, the folder of the shipped model, that one is left out.
    """
    found, name = _Found(bundle, registry, folder), version.name
    earlier = {
        decision.version: Champion(decision.version, decision.metrics)
        for decision in champions(registry, name)
        if decision.version != version.number and decision.robot == robot_digest(bundle.spec.world)
    }
    for one in reversed(registry.versions(name)):
        is_left = TAG_ROLLED_BACK in one.tags and ALIAS_CHAMPION not in one.aliases
        if is_left and earlier.pop(one.number, None) is not None:
            day = one.tags[TAG_ROLLED_BACK][:10]
            found.notes.append(f"not compared with version {one.number}, which was rolled back on {day}")
    against = None
    with suppress(ModelNotFoundError):
        present = registry.by_alias(name, ALIAS_CHAMPION)
        if present.number != version.number:
            measured = found.fetch(name, present.number, "the present champion")
            against = present.number if measured or present.number in earlier else None
            if measured:
                earlier.pop(present.number, None)
    for champion in _best_first(earlier.values(), bundle):
        if champion.version != against and found.fetch(name, champion.version, "the best before it"):
            del earlier[champion.version]
            break
    found.add_shipped(shipped)
    return tuple(found.rivals), Bar((), tuple(earlier.values()), tuple(found.notes), against)


def _best_first(champions: Iterable[Champion], bundle: Bundle) -> list[Champion]:
    """By their recorded metrics, each counted in the world's margins; those that lack some come last."""
    measures = simulator_of(bundle.spec.world).measures
    margins = measures.path_margins if bundle.spec.endpoints else measures.margins

    def rank(champion: Champion) -> tuple[int, float]:
        there = {name: value for name, value in champion.metrics.items() if name in margins}
        signs = {name: -1.0 if name in SMALLER_IS_BETTER else 1.0 for name in there}
        return len(there), sum(signs[name] * value / margins[name] for name, value in there.items())

    return sorted(champions, key=rank, reverse=True)


class _Found:
    """Rivals of a candidate, no bundle twice."""

    def __init__(self, candidate: Bundle, registry: ModelRegistry, folder: Path) -> None:
        self.rivals: list[Rival] = []
        self.notes: list[str] = []
        self._candidate, self._registry, self._folder = candidate, registry, folder
        self._seen = {candidate.digest}

    def fetch(self, name: str, number: int, words: str) -> bool:
        """Whether a version is a rival now, or has the bundle of the candidate or of another rival."""
        try:
            version = self._registry.version(name, number)
            bundle = load_verified(self._registry.download(version, self._folder / str(number)))
        except RegistryUnavailableError:
            raise
        except (RegistryError, BundleError) as error:
            why = f"can not be measured again ({error.what}): recorded metrics count"
            self.notes.append(f"version {number}, {words}, {why}")
            return False
        return self._add(f"version {number}, {words}", bundle, number)

    def add_shipped(self, folder: Path | None) -> None:
        """The shipped model where it is of this robot and kind."""
        if folder is None:
            self.notes.append("not compared with the shipped model, as requested")
            return
        if not folder.is_dir():
            raise ConfigError(
                "the shipped model is not here",
                expected="its bundle",
                got=str(folder),
                remedy="set CSPACE_PRETRAINED_MODEL, or do without the comparison: --without-shipped",
            )
        # Those of other robots lie beside it.
        beside = (folder.with_name(name) for name in SHIPPED.values())
        folders = dict.fromkeys([folder, *(one for one in beside if one.is_dir())])
        if not any(self._add("the shipped model", Bundle.load(one)) for one in folders):
            self.notes.append("no model of this robot and kind is shipped")

    def _add(self, name: str, bundle: Bundle, number: int | None = None) -> bool:
        spec, ours = bundle.spec, self._candidate.spec
        if spec.kind != ours.kind or robot_digest(spec.world) != robot_digest(ours.world):
            return False
        if bundle.digest == self._candidate.digest:
            self.notes.append(f"{name}, is this very bundle")
        elif bundle.digest not in self._seen:
            self._seen.add(bundle.digest)
            self.rivals.append(Rival(name, spec.world, PackedBundle.pack(bundle), number))
        return True
