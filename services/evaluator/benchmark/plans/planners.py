"""The models that plan: behind an API, or bundles in the process; each one pinned."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError, SamplerError
from cspace.planning.query import Plan, PlanQuery
from cspace.problem import UNIFORM, Problem
from cspace.space import JointSpace
from cspace.splits import Split
from cspace.world import World
from cspace.worlds import picture_file_of, robot_digest, workshop_of
from services.evaluator.benchmark.sources import SourceSpec, bundled
from services.planner.sources.sampling_client import RetryPolicy, SamplingClient

# A server's first plan may have to wait for its compiler.
_PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """What a model plans, and the time from the picture's file to the answer."""

    plan: Plan
    request_s: float


class Planner(Protocol):
    """Plans in a scene's picture."""

    def plan(self, picture: bytes, query: PlanQuery, world: World) -> Answer:
        """The answer to a picture's file.

        Args:
            picture: of the scene.
            query: start and goal.
            world: the scene's, whose robot may have other limits than the model is served with.

        Raises:
            SamplerError: there is none.
        """


@dataclass(frozen=True, slots=True)
class BundlePlanner:
    """A bundle in this process."""

    bundle: Bundle

    def plan(self, picture: bytes, query: PlanQuery, world: World) -> Answer:
        """See :class:`Planner`; the limits are those of the scene's robot."""
        bundle = self.bundle.within(world)
        began = time.perf_counter()
        prepared = bundle.prepare(world.read_picture(picture))
        return Answer(bundle.plan(prepared, query), time.perf_counter() - began)


@dataclass(frozen=True, slots=True)
class ServedPlanner:
    """A model behind an API."""

    client: SamplingClient
    spec: SourceSpec
    space: JointSpace

    def plan(self, picture: bytes, query: PlanQuery, world: World) -> Answer:
        """See :class:`Planner`; what needs wider limits than the model is served with counts as refused."""
        del world
        if not self.space.contains([query.start, query.goal]).all():
            return Answer(Plan("refused", np.empty((0, self.space.dim))), 0.0)
        found = self.client.plan(picture, query, self.spec.model)
        if found.model.digest != self.spec.digest:
            raise SamplerError(
                f"another model answers for {self.spec.name}",
                expected=self.spec.digest[:12],
                got=found.model.digest[:12],
            )
        return Answer(found.plan, found.round_trip_s)


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
    with _client(url, world) as client:
        told = client.plan(picture_file_of(problem.scenario), plan_query(problem), model).model
    pinned = f"{told.model_name}/{told.model_version}" if told.model_version else told.model_name
    return SourceSpec(name, told.digest, with_ends=True, model=pinned, url=url)


def plan_query(problem: Problem, seed: int = 0, time_limit_s: float = 1.0, ways: int = 1) -> PlanQuery:
    """For the least doubtful way and all others, however doubtful."""
    start, goal = (tuple(float(angle) for angle in end) for end in (problem.start, problem.goal))
    return PlanQuery(start, goal, seed, 0.0, time_limit_s, ways, alternatives=True)


@contextmanager
def opened_planners(specs: Sequence[SourceSpec], world: World) -> Iterator[Mapping[str, Planner]]:
    """The planners by name, each of them asked once, so that no first run pays for what only a first one has.

    Raises:
        SamplerError: one of them does not answer.
        BundleError: a bundle is damaged.
    """
    with ExitStack() as stack:
        found = {spec.name: _opened(spec, world, stack) for spec in specs}
        for planner in found.values():
            problem = _example(world)
            planner.plan(picture_file_of(problem.scenario), plan_query(problem), world)
        yield found


def _opened(spec: SourceSpec, world: World, stack: ExitStack) -> Planner:
    if spec.packed is not None:
        with TemporaryDirectory(prefix="cspace-bundle-") as folder:
            return BundlePlanner(Bundle.load(spec.packed.unpack(Path(folder))))
    client = stack.enter_context(_client(spec.url or "", world))
    return ServedPlanner(client, spec, world.space)


def _client(url: str, world: World) -> SamplingClient:
    policy = RetryPolicy(deadline_s=2.0 * _PATIENCE_S)
    return SamplingClient(url, _PATIENCE_S, policy=policy, robot=robot_digest(world))


def _example(world: World) -> Problem:
    return workshop_of(world).problem(UNIFORM, Split.DEMO, 0)
