"""Evaluated samplers, and scenarios with their pictures, ground truth and random streams."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.errors import EvaluationError
from cspace.query import SampleQuery
from cspace.simulator import UNIFORM, Checker, Measures, Problem, Split, scenario_rng
from cspace.space import JointSpace
from cspace.world import Scene as WorldScene
from cspace.world import World
from cspace.worlds import checker_of, simulator_of
from services.evaluator.metrics import Samples
from services.planner.samples import BundleSampler, SampleSource

Image = NDArray[np.uint8]

# At which a path model's samples are filtered for comparison: even odds.
PATH_CONFIDENCE = 0.5


def bundle_sampler(bundle: Bundle) -> BundleSampler:
    """A bundle with all that it can do; free samples are filtered as it recommends, those of paths alike."""
    sampler = BundleSampler(bundle)
    if bundle.has_validity:
        sampler.threshold = PATH_CONFIDENCE if bundle.spec.endpoints else bundle.spec.confidence_threshold
    return sampler


def unfiltered(sampler: SampleSource, image: Image, n: int, seed: int) -> NDArray[np.float64]:
    """``n`` configurations (n, d) rad for a picture (P, P, 3), whatever their confidence."""
    query = SampleQuery(n, seed, min_confidence=0.0)
    return np.asarray(sampler.answer(image, query).samples, dtype=np.float64)


@dataclass(frozen=True)
class PackedBundle:
    """A bundle's files as bytes, for workers that share no file system; told apart by the digest."""

    digest: str
    files: Mapping[str, bytes] = field(compare=False, repr=False)

    @classmethod
    def pack(cls, bundle: Bundle) -> "PackedBundle":
        """The files of a loaded bundle."""
        paths = sorted(path for path in bundle.folder.rglob("*") if path.is_file())
        named = {path.relative_to(bundle.folder).as_posix(): path.read_bytes() for path in paths}
        return cls(bundle.digest, named)

    def load(self) -> Bundle:
        """The bundle, verified again; it keeps what it needs in memory."""
        with TemporaryDirectory(prefix="cspace-bundle-") as folder:
            for name, data in self.files.items():
                target = Path(folder) / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            return Bundle.load(Path(folder))


SAMPLES = 1000
# Rejection gives up here; of planar scenarios the smallest free share that was ever drawn is 0.2.
PROPOSALS_PER_SAMPLE = 200
# The first child of a scenario's stream that a family owns, above all streams of the uniform one.
FAMILY_STREAM = 59


@dataclass(frozen=True)
class Stage:
    """What all scenarios of an evaluation share: whose arm, which camera, which split, which seed."""

    world: World
    split: Split
    seed: int


@dataclass(frozen=True)
class Scene:
    """One scenario with its ground truth; ``index`` is its number within split and family.

    Uniform scenarios are those of training; the others belong to problems of their family.
    """

    stage: Stage
    index: int
    family: str = UNIFORM
    given_problem: Problem | None = None

    @cached_property
    def problem(self) -> Problem | None:
        """Start and goal that make it a scenario of its family; None in the uniform one."""
        if self.family == UNIFORM or self.given_problem is not None:
            return self.given_problem
        stage = self.stage
        return simulator_of(stage.world).problem(self.family, stage.split, stage.seed, self.index)

    @cached_property
    def scenario(self) -> WorldScene:
        """The scenario, seen by the evaluation's camera."""
        if self.problem is None:
            return simulator_of(self.stage.world).scene(self._scenario_rng(), self.stage.split, self.index)
        return self.problem.scenario

    @cached_property
    def image(self) -> NDArray[np.uint8]:
        """Its picture, (P, P, 3)."""
        return simulator_of(self.scenario.world).render(self.scenario)

    @cached_property
    def checker(self) -> Checker:
        """Its exact collision checks."""
        return checker_of(self.scenario)

    @property
    def space(self) -> JointSpace:
        """The robot's joint space."""
        return self.stage.world.space

    @property
    def measures(self) -> Measures:
        """Numbers that fit the world."""
        return simulator_of(self.stage.world).measures

    def group(self, samples: NDArray[np.floating[Any]], held_out: NDArray[np.float64]) -> Samples:
        """(N, d) samples beside (M, d) held-out free configurations, as metrics take them."""
        if not len(samples) or not np.isfinite(samples).all():
            raise EvaluationError("the sampler returned no samples, or some that are not finite")
        radius_rad, is_free = self.measures.coverage_radius_rad, self.checker.valid_batch
        return Samples(samples.astype(np.float64), held_out, self.space, is_free, radius_rad)

    def rng(self, stream: int) -> np.random.Generator:
        """One of the scenario's own streams; independent of the one that drew it."""
        root = self._scenario_rng()
        if self.family != UNIFORM:
            names = simulator_of(self.stage.world).families.names
            root = _spawned(root, FAMILY_STREAM + names.index(self.family))
        return _spawned(root, stream)

    def sampler_seed(self, stream: int = 0) -> int:
        """A seed for the sampler under test, unsigned 63 bit."""
        return int(self.rng(10 + stream).integers(0, 2**63))

    def free(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """``count`` uniform free configurations, (count, d) rad."""
        found = self._draw(count, rng, free=True)
        if len(found) < count:
            raise EvaluationError("a scenario has next to no free space", got=f"{len(found)} of {count}")
        return found

    def collisions(self, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """At most ``count`` uniform configurations in collision; none where nothing is in reach."""
        return self._draw(count, rng, free=False)

    def _draw(self, count: int, rng: np.random.Generator, *, free: bool) -> NDArray[np.float64]:
        kept: list[NDArray[np.float64]] = []
        for _ in range(PROPOSALS_PER_SAMPLE // 2):
            proposals = self.space.sample_uniform(rng, 2 * count)
            kept.append(proposals[self.checker.valid_batch(proposals) == free])
            if sum(map(len, kept)) >= count:
                break
        return np.concatenate(kept)[:count]

    def _scenario_rng(self) -> np.random.Generator:
        return scenario_rng(self.stage.split, self.stage.seed, self.index)


def _spawned(rng: np.random.Generator, number: int) -> np.random.Generator:
    return rng.spawn(number + 1)[number]
