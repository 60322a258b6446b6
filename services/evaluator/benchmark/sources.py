"""The models of a benchmark: behind an API, or bundles in this process; each one pinned by its digest."""

import struct
import time
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from cspace.query import AlternativePath, Plan, PlanQuery, SampleQuery
from cspace.simulator import UNIFORM, Problem, Split
from cspace.space import JointSpace
from cspace.view_file import is_view, pack_view, unpack_view
from cspace.world import World
from cspace.worlds import picture_file_of, robot_digest, simulator_of
from services.evaluator.scenes import PackedBundle
from services.planner.client import FoundPlan, SamplingClient
from services.planner.planning import between_ends
from services.planner.samples import BundleSampler, SampleBatch, SampleSource

_END = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))
# A server's first plan may wait for its compiler.
_PATIENCE_S = 60.0


def fresh_picture(file: bytes, note: str) -> bytes:
    """A picture's file with a comment in its first PNG: another file with the same pixels.

    Raises:
        ValueError: the PNG does not end with an empty IEND chunk.
        ImageError: the view can not be read.
    """
    if is_view(file):
        view = unpack_view(file)
        pictures = [fresh_picture(view.pictures[0], note), *view.pictures[1:]]
        return pack_view(pictures, view.cameras, view.state, view.depth_scale_m, view.known)
    if not file.endswith(_END):
        raise ValueError("a PNG file ends with an empty IEND chunk")
    content = b"tEXtComment\0" + note.encode("latin-1")
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    return file.removesuffix(_END) + chunk + _END


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """All that a worker process needs to ask a model.

    Args:
        name: in the names of arms.
        digest: of the bundle that has to answer.
        with_ends: whether start and goal are sent, as path models require and others refuse.
        model: reference at the API, pinned to a version; None for a bundle.
        url: of the API; None for a bundle.
        packed: the bundle's files; None for a model behind an API.
    """

    name: str
    digest: str
    with_ends: bool
    model: str | None = None
    url: str | None = None
    packed: PackedBundle | None = None

    @property
    def described(self) -> dict[str, object]:
        """For manifest and report."""
        over = "HTTP" if self.url is not None else "none: a bundle in the planner's process"
        return {"model": self.model, "digest": self.digest, "with_ends": self.with_ends, "transport": over}

    def check(self, digest: str) -> None:
        """Refuse the answer of another model.

        Raises:
            SamplerError: the digest is not this model's.
        """
        if digest != self.digest:
            raise SamplerError(
                f"another model answers for {self.name}", expected=self.digest[:12], got=digest[:12]
            )


def parse_named(text: str) -> tuple[str, str]:
    """``NAME=VALUE``, or a value that is its own name up to its version.

    Raises:
        ConfigError: a part is empty.
    """
    name, separator, value = text.partition("=")
    if not separator:
        name, value = text.partition("@")[0].partition("/")[0], text
    if not name or not value or "," in name:
        raise ConfigError(
            "the sampler has no proper name", expected="NAME=VALUE without a comma", got=repr(text)
        )
    return name, value


def bundled(name: str, folder: Path) -> SourceSpec:
    """A bundle that answers in the planner's own process.

    Raises:
        BundleError: it is damaged.
    """
    bundle = load_verified(folder)
    return SourceSpec(name, bundle.digest, bundle.spec.kind == "path", packed=PackedBundle.pack(bundle))


def served(name: str, model: str, url: str, world: World) -> SourceSpec:
    """A sampler behind an API, pinned to the version that answers now.

    Raises:
        SamplerError: the API refuses, or does not answer.
    """
    problem, query = _example(world), SampleQuery(10, 1, min_confidence=0.0, robot=robot_digest(world))
    picture, with_ends = picture_file_of(problem.scenario), True
    with SamplingClient(url) as client:
        # Only its answers show whether a model takes start and goal.
        try:
            batch = client.answer(picture, between_ends(query, problem), model)
        except SamplerUnavailableError:
            raise
        except SamplerError:
            with_ends, batch = False, client.answer(picture, query, model)
    return SourceSpec(name, batch.digest, with_ends, _pinned(batch.model_name, batch.model_version), url)


def _pinned(name: str, version: int | None) -> str:
    # The shipped model has no number in a registry.
    return f"{name}/{version}" if version else name


@contextmanager
def opened(specs: Sequence[SourceSpec], world: World) -> Iterator[Mapping[str, SampleSource]]:
    """The samplers by name, each asked once, so that no run pays for a first request.

    Raises:
        SamplerError: one of them does not answer.
        BundleError: a bundle is damaged.
    """
    with ExitStack() as stack:
        found: dict[str, SampleSource] = {}
        for spec in specs:
            if spec.packed is not None:
                found[spec.name] = BundleSampler(spec.packed.load(), name=spec.name)
            else:
                found[spec.name] = stack.enter_context(SamplingClient(spec.url or ""))
            ask(found[spec.name], spec, _example(world), SampleQuery(10, 1, min_confidence=0.0))
        yield found


def ask(source: SampleSource, spec: SourceSpec, problem: Problem, query: SampleQuery) -> SampleBatch:
    """One batch for a problem's picture, as for a picture that was never sent before.

    Raises:
        SamplerUnavailableError: the source does not answer.
        SamplerError: it refused, or another model answered.
    """
    query = replace(query, robot=robot_digest(problem.scenario.world))
    note = f"{query.seed} {query.n} {query.epsilon_sigma} {query.min_confidence}"
    picture = fresh_picture(picture_file_of(problem.scenario), note)
    batch = source.answer(picture, between_ends(query, problem) if spec.with_ends else query, spec.model)
    spec.check(batch.digest)
    return batch


@dataclass(frozen=True, slots=True)
class PlanModel:
    """A model that plans, as a bundle in this process or behind an API."""

    spec: SourceSpec
    engine: Bundle | SamplingClient
    space: JointSpace

    def plan(self, picture: bytes, query: PlanQuery, world: World) -> tuple[Plan, float]:
        """The plan for a picture's file, and the time from the file to the answer, s.

        A problem that needs wider joint limits than a served model has counts as refused; a bundle takes the
        limits of ``world``.

        Raises:
            SamplerError: the API does not answer, or another model does.
        """
        if isinstance(self.engine, Bundle):
            bundle, began = self.engine.within(world), time.perf_counter()
            read = world.examine_picture(picture)
            plan = bundle.plan(bundle.prepare(read), query)
            return plan, time.perf_counter() - began
        if not self.space.contains(np.array([query.start, query.goal], dtype=np.float64)).all():
            return Plan("refused", np.empty((0, self.space.dim))), 0.0
        found = self.engine.plan(picture, query, self.spec.model)
        self.spec.check(found.model.digest)
        return _plan_of(found), found.round_trip_s


def _plan_of(found: FoundPlan) -> Plan:
    """An API's plan as a bundle's."""
    return Plan(
        found.status,
        found.path,
        confidence=found.confidence,
        edges=found.edges,
        unseen=found.unseen,
        length_rad=found.length_rad,
        found=found.ways,
        alternatives=tuple(
            AlternativePath(one.path, one.confidence, one.edges) for one in found.alternatives or ()
        ),
        search_ms=found.timing_ms.search,
        score_ms=found.timing_ms.score,
    )


def bundled_planner(name: str, folder: Path, world: World) -> SourceSpec:
    """A bundle that plans in this process.

    Raises:
        BundleError: it is damaged.
        ConfigError: it is another robot's, or has no validity head.
    """
    bundle = load_verified(folder)
    if bundle.robot != robot_digest(world) or not bundle.has_validity:
        raise ConfigError(
            f"the bundle {name} does not plan for this robot",
            expected="a validity head, and the robot of --robot",
            got=f"{'one' if bundle.has_validity else 'none'}, robot {bundle.robot[:12]}",
        )
    return bundled(name, folder)


def served_planner(name: str, model: str, url: str, world: World) -> SourceSpec:
    """A model behind an API, pinned to the version that answers now.

    Raises:
        SamplerError: the API refuses, or does not answer.
    """
    problem = _example(world)
    with _plan_client(url, world) as client:
        answering = client.plan(picture_file_of(problem.scenario), plan_query(problem), model).model
    pinned = _pinned(answering.name, answering.version)
    return SourceSpec(name, answering.digest, with_ends=True, model=pinned, url=url)


def plan_query(problem: Problem, seed: int = 0, time_limit_s: float = 1.0, paths: int = 1) -> PlanQuery:
    """For the path of the highest confidence and all others, at any confidence."""
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    return PlanQuery(start, goal, seed, 0.0, time_limit_s, paths, alternatives=True)


@contextmanager
def opened_planners(specs: Sequence[SourceSpec], world: World) -> Iterator[Mapping[str, PlanModel]]:
    """The planners by name, each asked once, so that no run pays for a first request.

    Raises:
        SamplerError: one of them does not answer.
        BundleError: a bundle is damaged.
    """
    problem = _example(world)
    with ExitStack() as stack:
        found = {}
        for spec in specs:
            engine: Bundle | SamplingClient
            if spec.packed is None:
                engine = stack.enter_context(_plan_client(spec.url or "", world))
            else:
                engine = spec.packed.load()
            found[spec.name] = PlanModel(spec, engine, world.space)
            found[spec.name].plan(picture_file_of(problem.scenario), plan_query(problem), world)
        yield found


def _plan_client(url: str, world: World) -> SamplingClient:
    return SamplingClient(url, _PATIENCE_S, deadline_s=2.0 * _PATIENCE_S, robot=robot_digest(world))


def _example(world: World) -> Problem:
    return simulator_of(world).problem(UNIFORM, Split.DEMO, 0)
