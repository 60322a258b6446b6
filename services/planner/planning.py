"""Planning with one batch of samples, drawn before the search; comparisons and plans of the API in words."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from tabulate import tabulate

from cspace.errors import SamplerError, SamplerModelError, SamplerUnavailableError
from cspace.planning.paths import spaced
from cspace.query import PlanQuery, SampleQuery
from cspace.simulator import OWN, Problem
from cspace.world import World
from cspace.worlds import checker_of, default_world, picture_file_of, robot_digest, simulator_of
from cspace_client import FoundPlan, PictureWarning
from services.names import label, model_name
from services.planner.ompl_planner import DEFAULT_UNIFORM_SHARE, solve
from services.planner.result import CHECK_FACTOR, RRT_CONNECT, PlannerSettings, PlanResult, Reason
from services.planner.samples import SampleBatch, SampleSource, SamplingClient, usual_api
from services.scene_files import read_scene_file

DEFAULT_SAMPLES = 300
# The percentile of novelty up to which a picture counts as one like those of the training.
ORDINARY = 0.95


@dataclass(frozen=True, slots=True)
class SampleRequest:
    """What is asked of a source of samples for one problem, whose ends are sent to path models.

    ``or_uniform``: uniform samples do where there is no such model.
    """

    query: SampleQuery
    model: str | None = None
    with_ends: bool = False
    or_uniform: bool = False

    def of_robot(self, world: World, name: str | None = None) -> "SampleRequest":
        """The request for the model of a robot of one's own where it names no model."""
        if self.model is not None or robot_digest(world) == robot_digest(default_world()):
            return self
        own = model_name(world, name or label(world), path=self.with_ends)
        return replace(self, model=own, or_uniform=True)


@dataclass(frozen=True, slots=True, eq=False)
class SampledPlan:
    """One problem solved with samples from a source, or without: ``unavailable`` says why.

    The uniform share is raised by the picture's novelty.
    """

    result: PlanResult
    batch: SampleBatch | None
    unavailable: str | None
    uniform_share: float


def plan(
    problem: Problem,
    source: SampleSource,
    settings: PlannerSettings,
    request: SampleRequest | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    *,
    keep_tree: bool = False,
) -> SampledPlan:
    """Render the picture, ask for one batch, solve; with uniform samples where the source does not answer."""
    request = request or SampleRequest(SampleQuery(DEFAULT_SAMPLES, settings.seed))
    batch, unavailable, samples = None, None, None
    try:
        batch = request_samples(problem, source, request)
        samples, uniform_share = batch.samples, raised_share(uniform_share, batch.novelty)
    except SamplerUnavailableError as error:
        unavailable = str(error)
    except SamplerModelError:
        if not request.or_uniform:
            raise
        unavailable = f"there is no {request.model} yet"
    result = solve(problem, settings, samples, uniform_share, keep_tree=keep_tree)
    return SampledPlan(result, batch, unavailable, uniform_share)


def plan_scene(
    path: str | Path, api: str | None = None, settings: PlannerSettings | None = None
) -> SampledPlan:
    """Solve the problem of a scene file with samples of the robot's own model from an API."""
    scene, settings = read_scene_file(Path(path)), settings or PlannerSettings()
    request = SampleRequest(SampleQuery(DEFAULT_SAMPLES, settings.seed)).of_robot(scene.world, scene.name)
    with SamplingClient(api or usual_api()) as client:
        return plan(scene.problem(), client, settings, request)


def raised_share(uniform_share: float, novelty: float | None) -> float:
    """The share of uniform samples for a picture of some novelty: all of them for one like no other.

    It rises in proportion above the 95th percentile of novelty; a novelty of None changes nothing.
    """
    beyond = max(0.0, ((novelty or 0.0) - ORDINARY) / (1.0 - ORDINARY))
    return uniform_share + (1.0 - uniform_share) * beyond


def request_samples(problem: Problem, source: SampleSource, request: SampleRequest) -> SampleBatch:
    """One batch for a problem's picture."""
    query = replace(request.query, robot=robot_digest(problem.scenario.world))
    query = between_ends(query, problem) if request.with_ends else query
    batch = source.answer(picture_file_of(problem.scenario), query, request.model)
    dim, got = problem.space.dim, batch.samples.shape[1]
    if len(batch.samples) and got != dim:
        what = f"the samples of {batch.model_name}/{batch.model_version} are for another robot"
        remedy = "name a model of this robot"
        raise SamplerError(what, expected=f"{dim} joints", got=str(got), remedy=remedy)
    return batch


def between_ends(query: SampleQuery, problem: Problem) -> SampleQuery:
    """The query with the start and the goal of a problem, as path models are asked."""
    return replace(query, start=tuple(problem.start.tolist()), goal=tuple(problem.goal.tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One problem solved under one seed with learned samples, with uniform ones, and by OMPL's RRTConnect."""

    problem: Problem
    planner: str
    learned: SampledPlan
    uniform: PlanResult
    connect: PlanResult

    @property
    def results(self) -> dict[str, PlanResult]:
        """The runs by name, the one with the source's samples first."""
        first = "learned" if self.learned.batch is not None else "no samples"
        return {
            f"{self.planner}, {first}": self.learned.result,
            f"{self.planner}, uniform": self.uniform,
            "RRTConnect, uniform": self.connect,
        }


def compare(
    problem: Problem,
    source: SampleSource,
    settings: PlannerSettings,
    request: SampleRequest | None = None,
) -> Comparison:
    """Solves the problem in all three ways and keeps the trees."""
    learned = plan(problem, source, settings, request, keep_tree=True)
    uniform = solve(problem, settings, keep_tree=True)
    connect = solve(problem, replace(settings, planner=RRT_CONNECT), keep_tree=True)
    return Comparison(problem, settings.planner, learned, uniform, connect)


def comparison_text(comparison: Comparison) -> str:
    """Problem, samples and one line for each run."""
    batch = comparison.learned.batch
    samples = f"none, going on with uniform samples: {comparison.learned.unavailable}"
    if batch is not None:
        dropped = f" ({batch.shortfall} too few)" if batch.shortfall else ""
        new = "" if batch.novelty is None else f", novelty {batch.novelty:.2f}"
        samples = (
            f"{len(batch.samples)}{dropped} from {batch.model_name}/{batch.model_version} "
            f"(digest {batch.digest[:12]}, seed {batch.seed}) in {1e3 * batch.round_trip_s:.1f} ms{new}"
        )
    rows = [
        {
            "planner": name,
            "outcome": str(one.reason),
            "iterations": one.iterations,
            "edges": one.edge_checks,
            "states": one.state_checks,
            "learned": one.learned_drawn,
            "uniform": one.uniform_drawn,
            "length rad": round(one.length_rad, 2) if one.solved else None,
            "time ms": round(1e3 * one.solve_time_s, 2),
        }
        for name, one in comparison.results.items()
    ]
    table = tabulate(rows, "keys", tablefmt="plain", missingval="-")
    head = [f"problem  {problem_line(comparison.problem)}", f"samples  {samples}"]
    return "\n".join([*head, *warning_lines(() if batch is None else batch.warnings), "", table])


def problem_line(problem: Problem) -> str:
    """A problem in a few words."""
    if problem.family == OWN:
        return f"your own, {problem.space.dim} joints"
    words = (problem.family, f"seed {problem.seed}", f"{problem.space.dim} joints", problem.passage)
    return ", ".join(filter(None, words))


def warning_lines(warnings: Iterable[PictureWarning]) -> list[str]:
    """What is wrong, or may be, with a problem's pictures, a line each."""
    return [f"warning  {one.code}: {one.message}" for one in warnings]


@dataclass(frozen=True, slots=True, eq=False)
class WholePlan:
    """The API's plan for a problem, checked against the true scene."""

    problem: Problem
    found: FoundPlan
    clearance_m: float

    @property
    def free(self) -> bool:
        """Whether there is a path that touches nothing."""
        return self.clearance_m > 0.0

    @property
    def result(self) -> PlanResult:
        """As planners return it, for plots."""
        plan = self.found
        return PlanResult(
            solved=len(plan.path) > 0,
            path=plan.path,
            length_rad=plan.length_rad if len(plan.path) else math.nan,
            solve_time_s=1e-3 * (plan.timing_ms.search + plan.timing_ms.score),
            reason=Reason.SOLVED if len(plan.path) else Reason.NO_PATH,
        )


def ask_for_plan(
    problem: Problem, client: SamplingClient, query: PlanQuery, model: str | None = None
) -> WholePlan:
    """Requests a plan and checks its path against the true scene."""
    found = client.plan(picture_file_of(problem.scenario), query, model)
    clearance_m = math.nan
    if len(found.path):
        step_rad = simulator_of(problem.scenario.world).measures.resolution_rad / CHECK_FACTOR
        states = spaced(found.path, problem.space, step_rad)
        clearance_m = float(np.min(checker_of(problem.scenario).clearance(states)))
    return WholePlan(problem, found, clearance_m)


def plan_text(whole: WholePlan) -> str:
    """The outcome in words; the last line is the ground truth."""
    plan, model = whole.found, whole.found.model
    parts = f"search {plan.timing_ms.search:.0f}, scoring {plan.timing_ms.score:.0f}"
    times = f"{1e3 * plan.round_trip_s:.0f} ms: {parts}"
    lines = [
        f"problem  {problem_line(whole.problem)}",
        f"plan     {plan.status} by {model.name}/{model.version} in {times}",
    ]
    if plan.reason is not None:
        lines.append(f"reason   {plan.reason}")
    lines.extend(warning_lines(plan.warnings))
    if len(plan.path):
        unseen = (
            "" if plan.unseen is None else f", up to {plan.unseen.max():.0%} of the robot in unknown space"
        )
        lines.append(
            f"path     {plan.length_rad:.2f} rad over {len(plan.edges)} edges, the best of {plan.ways}: "
            f"confidence {plan.confidence:.3f}, lowest {plan.edges.min():.3f}{unseen}"
        )
        outcome = "collision-free" if whole.free else "collides"
        lines.append(f"truth    {outcome}, minimum clearance {1e3 * whole.clearance_m:.0f} mm")
    return "\n".join(lines)
