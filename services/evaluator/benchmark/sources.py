"""The models of a benchmark: behind an API, or bundles in this process; each one pinned by its digest."""

import io
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, PngImagePlugin

from cspace.bundle import Bundle, load_verified
from cspace.errors import ConfigError, SamplerError, SamplerUnavailableError
from cspace.query import DEFAULT_PATHS, Plan, PlanQuery, SampleQuery
from cspace.simulator import UNIFORM, Problem, Split
from cspace.world import World
from cspace.worlds import picture_file_of, robot_digest, simulator_of
from services.evaluator.scenes import PackedBundle
from services.planner.planning import between_ends
from services.planner.samples import BundleSampler, FoundPlan, SampleBatch, SamplingClient

# A server's first plan may wait for its compiler.
_TIMEOUT_S = 60.0
_PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """All that a worker needs to ask a model: a reference at an API, pinned to a version, or a packed bundle.

    ``with_ends``: start and goal are sent, as path models require and others refuse.
    """

    name: str
    digest: str
    with_ends: bool
    model: str | None = None
    url: str | None = None
    packed: PackedBundle | None = None

    @property
    def described(self) -> dict[str, Any]:
        """For manifest and report."""
        transport = "none: a bundle in the planner's process" if self.url is None else "HTTP"
        named = {name: getattr(self, name) for name in ("model", "digest", "with_ends")}
        return named | {"transport": transport}

    def check(self, digest: str) -> None:
        """Raises SamplerError where another model answered."""
        if digest != self.digest:
            raise SamplerError(
                f"another model answers for {self.name}", expected=self.digest[:12], got=digest[:12]
            )


def parse_named(text: str) -> tuple[str, str]:
    """``NAME=VALUE``, or a value that is its own name up to its version."""
    name, separator, value = text.partition("=")
    if not separator:
        name, value = text.partition("@")[0].partition("/")[0], text
    if not name or not value or "," in name:
        raise ConfigError(
            "the model has no proper name", expected="NAME=VALUE without a comma", got=repr(text)
        )
    return name, value


def bundled(name: str, folder: Path, plans_for: World | None = None) -> SourceSpec:
    """A bundle that answers in the planner's own process; with a world it has to plan for its robot."""
    bundle = load_verified(folder)
    if plans_for is not None and not (bundle.has_validity and bundle.robot == robot_digest(plans_for)):
        raise ConfigError(
            f"the bundle {name} does not plan for this robot",
            expected="a validity head, and the robot of --robot",
            got=f"{'one' if bundle.has_validity else 'none'}, robot {bundle.robot[:12]}",
        )
    return SourceSpec(name, bundle.digest, bundle.spec.kind == "path", packed=PackedBundle.pack(bundle))


def served(name: str, model: str, url: str, world: World, *, plans: bool = False) -> SourceSpec:
    """A model behind an API, pinned to the version that answers now."""
    problem, with_ends = _example(world), True
    query = SampleQuery(10, 1, min_confidence=0.0, robot=robot_digest(world))
    picture = picture_file_of(problem.scenario)
    with _client(url, world) as client:
        if plans:
            found: Any = client.plan(picture, plan_query(problem, 0, 1.0), model).model
        else:
            # Only its answers show whether a model takes start and goal.
            try:
                found = client.answer(picture, between_ends(query, problem), model)
            except SamplerUnavailableError:
                raise
            except SamplerError:
                with_ends, found = False, client.answer(picture, query, model)
    # The shipped model has no number in a registry.
    name_there, number = (found.name, found.version) if plans else (found.model_name, found.model_version)
    pinned = f"{name_there}/{number}" if number else name_there
    return SourceSpec(name, found.digest, with_ends, pinned, url)


class Model:
    """An opened model."""

    def __init__(self, spec: SourceSpec, world: World, stack: ExitStack) -> None:
        self._spec, self._space = spec, world.space
        if spec.packed is not None:
            self._bundle: Bundle | None = spec.packed.load()
            self._source: BundleSampler | SamplingClient = BundleSampler(self._bundle, name=spec.name)
        else:
            self._bundle = None
            self._source = stack.enter_context(_client(spec.url or "", world))

    def sample(self, problem: Problem, query: SampleQuery) -> SampleBatch:
        """One batch for a problem's picture, as for a picture that the model has not seen before."""
        query = replace(query, robot=robot_digest(problem.scenario.world))
        query = between_ends(query, problem) if self._spec.with_ends else query
        picture = fresh_picture(picture_file_of(problem.scenario), f"{query.seed} {query.n}")
        batch = self._source.answer(picture, query, self._spec.model)
        self._spec.check(batch.digest)
        return batch

    def plan(self, problem: Problem, query: PlanQuery) -> tuple[Plan, float]:
        """The plan for a problem's picture, and the time from the file to the answer, s.

        A problem that needs wider joint limits than a served model has counts as refused; a bundle takes the
        limits of the problem's world.
        """
        picture, world = picture_file_of(problem.scenario), problem.scenario.world
        if self._bundle is not None:
            bundle, began = self._bundle.within(world), time.perf_counter()
            plan = bundle.plan(bundle.prepare(world.examine_picture(picture)), query)
            return plan, time.perf_counter() - began
        if not self._space.contains(np.array([query.start, query.goal], dtype=np.float64)).all():
            return Plan("refused", np.empty((0, self._space.dim))), 0.0
        found = self._source.plan(picture, query, self._spec.model)  # type: ignore[union-attr]
        self._spec.check(found.model.digest)
        return _plan_of(found), found.round_trip_s


def opened(specs: Sequence[SourceSpec], world: World, stack: ExitStack, *, plans: bool) -> dict[str, Model]:
    """The models by name, each asked once, so that no run pays for a first request."""
    problem, found = _example(world), {}
    for spec in specs:
        found[spec.name] = model = Model(spec, world, stack)
        if plans:
            model.plan(problem, plan_query(problem, 0, 1.0))
        else:
            model.sample(problem, SampleQuery(10, 1, min_confidence=0.0))
    return found


def plan_query(problem: Problem, seed: int, time_limit_s: float) -> PlanQuery:
    """For the path of the highest confidence and all others, at any confidence."""
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    return PlanQuery(start, goal, seed, 0.0, time_limit_s, DEFAULT_PATHS, alternatives=True)


def fresh_picture(file: bytes, note: str) -> bytes:
    """A PNG with a comment: another file with the same pixels; depth views stay as they are."""
    if not file.startswith(_PNG):
        return file
    info, target = PngImagePlugin.PngInfo(), io.BytesIO()
    info.add_text("Comment", note)
    Image.open(io.BytesIO(file)).save(target, "PNG", pnginfo=info)
    return target.getvalue()


def _client(url: str, world: World) -> SamplingClient:
    return SamplingClient(url, _TIMEOUT_S, deadline_s=2.0 * _TIMEOUT_S, robot=robot_digest(world))


def _plan_of(found: FoundPlan) -> Plan:
    """An API's plan as a bundle's."""
    return Plan(
        found.status,
        found.path,
        confidence=found.confidence,
        edges=found.edges,
        search_ms=found.timing_ms.search,
        score_ms=found.timing_ms.score,
    )


def _example(world: World) -> Problem:
    return simulator_of(world).problem(UNIFORM, Split.DEMO, 0)
