"""The deployable artefact: load it, verify it, sample from it, write it; no torch, no pickle."""

import math
import time
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from cspace import bounded_worker
from cspace.bundle.files import (
    ENCODER_FILE,
    GOLDEN_FILE,
    OPTIONAL_FILES,
    SPEC_FILE,
    SUMS_FILE,
    BundleFiles,
    GoldenCase,
    check_graph,
    endpoints,
    read_files,
    scene,
    sums_of,
)
from cspace.bundle.runtime import Graph, container_bytes, open_graphs
from cspace.bundle.sampling import (
    Encoding,
    GeneratorSampler,
    Head,
    OccupancyGrid,
    PathSampler,
    Picture,
    SampleSet,
)
from cspace.bundle.spec import (
    MAP,
    OCCUPANCY,
    PICTURE,
    WAYS,
    BundleSpec,
    fitted,
    fitted_plan,
    fitted_problem,
)
from cspace.errors import BundleError, BundleIntegrityError, InputError, StorageError
from cspace.files import replacing
from cspace.plan import plan
from cspace.query import Plan, PlanQuery, SampleQuery
from cspace.world import CheckCancelled, Examined, World
from cspace.worlds import robot_digest

QUANTILES = 101


def novelty(scores: NDArray[np.float32], quantiles: Sequence[Sequence[float]]) -> float:
    """The share of known pictures that are less unusual, 0 to 1; 1 beyond all of them.

    Every score (s,) is ranked among the quantiles of known pictures, evenly spaced. The highest rank counts;
    its distance from 1 is multiplied by the number of scores (Bonferroni).
    """
    ranks = [
        float(np.interp(score, known, np.linspace(0.0, 1.0, len(known))))
        for score, known in zip(scores.tolist(), quantiles, strict=True)
    ]
    return max(0.0, 1.0 - len(ranks) * (1.0 - max(ranks)))


def quantiles_of(scores: NDArray[np.floating]) -> tuple[tuple[float, ...], ...]:
    """Evenly spaced quantiles of (n, s) scores of known pictures, s rows of 101 values."""
    found = np.quantile(scores.astype(np.float64), np.linspace(0.0, 1.0, QUANTILES), axis=0).T
    return tuple(tuple(row) for row in found.tolist())


class Bundle:
    """A loaded bundle; safe to share between threads. Make one with :meth:`load`."""

    def __init__(self, folder: Path, files: BundleFiles) -> None:
        self.folder = folder
        self.digest = files.digest
        self.spec = BundleSpec.from_json(files.contents[SPEC_FILE])
        self.robot = robot_digest(self.spec.world)
        self._graphs = open_graphs(self.spec, files)
        self._validity = None if self._graphs.validity is None else Head(self._graphs.validity)
        self.head_looks_at_map = self._validity is not None and self._validity.looks_at_map

    @classmethod
    def load(
        cls,
        folder: Path,
        *,
        digest: str | None = None,
        check: bool = True,
        replay: bool = True,
    ) -> "Bundle":
        """Read a bundle, verify its sums, schema and graphs, and replay its golden case.

        Open untrusted bundles with :func:`load_verified`. ``digest``: that the bundle has to have; any when
        None. ``check``: False where the graphs of this digest were checked, or come with the program.
        """
        files = read_files(Path(folder))
        if digest not in (None, files.digest):
            raise BundleIntegrityError(
                "the bundle is not the one that was registered", expected=f"digest {digest}", got=files.digest
            )
        if check:
            for name, data in files.contents.items():
                if name.endswith(".onnx"):
                    check_graph(name, data)
        bundle = cls(Path(folder), files)
        if replay:
            bundle._replay(GoldenCase.from_npz(files.contents[GOLDEN_FILE]))
        return bundle

    def within(self, world: World) -> "Bundle":
        """The same model for its robot with the joint limits of another world's; graphs are shared."""
        found = copy(self)
        found.spec = replace(self.spec, world=replace(cast("Any", self.spec.world), body=world.body))
        found.robot = robot_digest(found.spec.world)
        return found

    @property
    def has_validity(self) -> bool:
        return self._validity is not None

    @property
    def _sampler(self) -> GeneratorSampler | PathSampler:
        if self._graphs.generator is None:
            return PathSampler(self.spec, self._head())
        return GeneratorSampler(self.spec, self._graphs.generator, self._validity)

    def prepare(self, picture: NDArray[np.uint8] | Examined) -> Picture:
        """An encoded picture, of one that is decoded, uint8 (P, P, 3), or that a world has examined."""
        image = picture.images[0] if isinstance(picture, Examined) else picture
        pixels = self._network_image(image)
        read = picture if isinstance(picture, Examined) else Examined(image[None])
        size = (1, self.spec.latent_dim)
        found = self._graphs.encoder.run({PICTURE: pixels}, {"mu": size, "sigma": size})
        graph, field = self._graphs.map, self._graphs.field
        return Picture(
            self.digest,
            image,
            self.spec.world.sensor,
            Encoding(found["mu"][0], found["sigma"][0]),
            self._novelty_of(image, pixels, found["mu"]),
            None if graph is None else graph.run({PICTURE: pixels}, {MAP: graph.fixed_shape(MAP)})[MAP],
            read.known,
            read.pictures,
            None if field is None else cache(lambda: self._occupancy(field, image)),
        )

    def _occupancy(self, field: Graph, image: NDArray[np.uint8]) -> NDArray[np.float16]:
        # Made again, for the pixels have four times the image's bytes.
        pixels = self._network_image(image)
        found = field.run({PICTURE: pixels}, {OCCUPANCY: image.shape[:-1]})[OCCUPANCY]
        if np.any((found < 0.0) | (found > 1.0)):
            raise BundleError("field.onnx gives no probabilities", expected="values from 0 to 1")
        return found.astype(np.float16)

    def _novelty_of(
        self, image: NDArray[np.uint8], pixels: NDArray[np.float32], mu: NDArray[np.float32]
    ) -> float | None:
        graph, quantiles = self._graphs.novelty, self.spec.novelty_quantiles
        if graph is None or quantiles is None:
            return None
        found = graph.run({PICTURE: pixels, "mu": mu}, {"scores": (len(quantiles),)})
        # Scores learned from pictures that show something are low for one that shows nothing.
        return max(novelty(found["scores"], quantiles), self.spec.world.least_novelty(image))

    def sample(
        self,
        image: NDArray[np.uint8] | Picture,
        n: int,
        seed: int,
        *,
        report_confidence: bool = True,
        check_cancelled: CheckCancelled = lambda: None,
        **options: Any,
    ) -> SampleSet:
        query = SampleQuery.checked(n, seed, **options)
        return self.answer(image, query, report_confidence=report_confidence, check_cancelled=check_cancelled)

    def answer(
        self,
        image: NDArray[np.uint8] | Picture,
        query: SampleQuery,
        *,
        report_confidence: bool = True,
        check_cancelled: CheckCancelled = lambda: None,
    ) -> SampleSet:
        """Configurations for a picture; the same query gives bit-equal samples on one machine.

        With a confidence to reach, more are drawn and scored until ``n`` reach it, or the budget of four
        times ``n`` is spent and the answer falls short. The samples for a smaller ``n`` are no prefix of
        those for a larger one. ``report_confidence``: whether samples are scored that are not filtered.
        """
        request = fitted(query, self.spec, has_validity=self.has_validity)
        began = time.perf_counter()
        picture = self._prepared(image)
        encoded = time.perf_counter()

        found = self._sampler.sample(
            picture, request, report_confidence=report_confidence, check_cancelled=check_cancelled
        )
        if picture.known is not None:
            # Where all are wanted, those that nothing has replaced are still among them.
            free = picture.known.free(found.samples, check_cancelled)
            ways = None if found.ways is None else found.ways[free]
            found = replace(found, samples=found.samples[free], scores=found.scores[free], ways=ways)
        return replace(
            found,
            shortfall=request.n - len(found.samples),
            encode_ms=0.0 if picture is image else 1e3 * (encoded - began),
            generate_ms=1e3 * (time.perf_counter() - encoded),
        )

    def plan(
        self,
        image: NDArray[np.uint8] | Picture,
        query: PlanQuery,
        check_cancelled: CheckCancelled = lambda: None,
        calibration: tuple[float, float] | None = None,
    ) -> Plan:
        """The path from start to goal of lowest cost; ``calibration`` (a, b) is in place of the bundle's."""
        picture, ends = self._prepared(image), fitted_problem(self.spec, query)
        seen = self._head().seen(self.spec, picture, check_cancelled)
        if calibration is not None:
            seen = replace(seen, plan_calibration=calibration)
        if picture.occupancy is not None:
            seen = replace(seen, occupancy=picture.occupancy())
        return plan(seen, ends, fitted_plan(self.spec, query), check_cancelled)

    def golden_answer(self, image: NDArray[np.uint8], query: SampleQuery) -> SampleSet:
        """:meth:`answer`, or uniform samples where they are searched for, which needs more packages."""
        if self.spec.model_kind != WAYS:
            return self.answer(image, query)
        rng, space = np.random.default_rng(query.seed), self.spec.world.space
        rows = space.to_float32(space.sample_uniform(rng, query.n))
        return SampleSet(rows, self._head().scores(self.prepare(image), rows, lambda: None))

    def predict(
        self,
        image: NDArray[np.uint8] | Picture,
        configurations: NDArray[np.float32],
        check_cancelled: CheckCancelled = lambda: None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """P(free) of (n, d) rad, (n,), and the robot's share in unknown space, None where all is seen."""
        return self._head().predict(self._prepared(image), configurations, check_cancelled)

    def occupancy_grid(self, image: NDArray[np.uint8] | Picture) -> OccupancyGrid:
        """What the model takes the whole scene of an image (X, Y, Z, 2) to be, seen or not."""
        self.require_field()
        picture, grid = self._prepared(image), cast("Any", self.spec.world.sensor).grid
        found = cast("Any", picture.occupancy)().astype(np.float32)
        x, y, z = (count // 2 for count in grid.counts)
        cells = found.reshape(x, 2, y, 2, z, 2).max(axis=(1, 3, 5))
        return OccupancyGrid(grid.low_m, 2.0 * grid.voxel_m, cells)

    def require_field(self) -> None:
        if self._graphs.field is None:
            raise InputError(
                "the model cannot tell what it takes the scene to be",
                expected="a model of an arm that sees with depth cameras, with field.onnx",
                remedy="make the model again with this version of training",
            )

    def _head(self) -> Head:
        if self._validity is None:
            raise InputError("the model has no validity head", remedy="train one with validity.steps above 0")
        return self._validity

    def _prepared(self, image: NDArray[np.uint8] | Picture) -> Picture:
        return image if isinstance(image, Picture) else self.prepare(image)

    def _network_image(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        shape = self.spec.world.sensor.picture_shape
        if getattr(image, "shape", None) != shape or image.dtype != np.uint8:
            got = f"{getattr(image, 'dtype', type(image).__name__)} {getattr(image, 'shape', '')}"
            raise InputError("the picture does not fit the model", expected=f"uint8 {shape}", got=got)
        return self.spec.world.sensor.to_network(image[None])

    def _replay(self, case: GoldenCase) -> None:
        try:
            encoding = self.prepare(case.image).encoding
            answer = self.golden_answer(case.image, case.query)
        except InputError as error:
            raise BundleIntegrityError("the golden case does not fit its bundle", got=str(error)) from error
        case.compare(encoding.mu, encoding.sigma, answer.samples, answer.confidence, self.spec.world.space)


GOLDEN_SEED = 20_240_229
# Odd, so that it is a multiple of no usual number of samples per latent.
GOLDEN_COUNT = 65
GOLDEN_EPSILON = (0.0, 0.5)

# By the names of graphs.
_GRAPH_FILES = {file.removesuffix(".onnx"): file for file in (ENCODER_FILE, *OPTIONAL_FILES)}


def write_bundle(
    folder: Path, spec: BundleSpec, graphs: Mapping[str, bytes], golden: GoldenCase | None = None
) -> Path:
    """Write a bundle beside its place, load it there as any reader would, and rename it."""
    folder = Path(folder)
    contents = {SPEC_FILE: spec.to_json(), **{_GRAPH_FILES[name]: data for name, data in graphs.items()}}
    contents[GOLDEN_FILE] = (golden or _compute_golden(folder, contents)).to_npz()
    if folder.exists():
        raise StorageError("the bundle's folder exists", expected="a new folder", got=folder.name)
    with replacing(folder, "the bundle") as beside:
        beside.mkdir(parents=True)
        for name, data in {**contents, SUMS_FILE: sums_of(contents)}.items():
            (beside / name).write_bytes(data)
        Bundle.load(beside)
    return folder


def graphs_of(folder: Path) -> dict[str, bytes]:
    """The graphs of a bundle as :func:`write_bundle` takes them, from its folder."""
    files = {name: folder / file for name, file in _GRAPH_FILES.items()}
    return {name: file.read_bytes() for name, file in files.items() if file.is_file()}


def _compute_golden(folder: Path, contents: Mapping[str, bytes]) -> GoldenCase:
    bundle = Bundle(folder, BundleFiles(contents, digest=""))
    image = scene(bundle.spec.world.sensor.picture_shape)
    start, goal = endpoints(bundle.spec.endpoints, bundle.spec.world.space)
    query = SampleQuery(GOLDEN_COUNT, GOLDEN_SEED, GOLDEN_EPSILON, start, goal, min_confidence=0.0)
    encoding, answer = bundle.prepare(image).encoding, bundle.golden_answer(image, query)
    return GoldenCase(image, query, encoding.mu, encoding.sigma, answer.samples, answer.confidence)


# A bundle's graphs may compute for hours or eat memory, and neither can be interrupted within a process.
VERIFY_S = 30.0
# Beyond what the worker holds with its libraries; in a container at most this share of its limit.
MEMORY_BYTES, CONTAINER_SHARE = 2**30, 0.25


def verify(folder: Path, digest: str | None = None, limit_s: float = VERIFY_S) -> str:
    """The digest of a bundle whose sums, digest, graphs and golden case hold in a worker process."""
    container = container_bytes()
    memory = MEMORY_BYTES if container is None else min(MEMORY_BYTES, int(container * CONTAINER_SHARE))
    limits = bounded_worker.Limits(memory, math.ceil(limit_s), limit_s)
    found: str = bounded_worker.call(
        checked_digest,
        str(folder.absolute()),
        digest,
        limits=limits,
        what="the bundle",
        error=BundleError,
        remedy="export it again",
    )
    return found


def checked_digest(folder: str, digest: str | None) -> str:
    """The digest of a bundle that loads with all checks; to be called in a worker."""
    return Bundle.load(Path(folder), digest=digest).digest


def load_verified(folder: Path, digest: str | None = None) -> Bundle:
    """Verify a bundle in a worker process, then open it here."""
    return Bundle.load(folder, digest=verify(folder, digest), check=False, replay=False)
