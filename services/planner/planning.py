"""Planning with a source of samples: one batch of samples from a source before the search, none during it."""

from dataclasses import dataclass, replace
from pathlib import Path

from cspace.errors import SamplerError, SamplerModelError, SamplerUnavailableError
from cspace.query import SampleQuery
from cspace.simulator import Problem
from cspace.world import World
from cspace.worlds import default_world, picture_file_of, robot_digest
from services.names import label, model_name
from services.planner.client import SamplingClient, usual_api
from services.planner.ompl_planner import DEFAULT_UNIFORM_SHARE, solve
from services.planner.result import PlanResult
from services.planner.samples import SampleBatch, SampleSource
from services.planner.settings import PlannerSettings
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
    """One problem solved with samples from a source, or without where there were none.

    Args:
        result: of the planner.
        batch: the samples; None when the source did not answer.
        unavailable: why there are none, in words; None when there are.
        uniform_share: of uniform samples mixed in, raised by the picture's novelty.
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
    dim = problem.space.dim
    if len(batch.samples) and batch.samples.shape[1] != dim:
        raise SamplerError(
            f"the samples of {batch.model_name}/{batch.model_version} are for another robot",
            expected=f"{dim} joints",
            got=f"{batch.samples.shape[1]}",
            remedy="name a model of this robot",
        )
    return batch


def between_ends(query: SampleQuery, problem: Problem) -> SampleQuery:
    """The query with the start and the goal of a problem, as path models are asked."""
    return replace(query, start=tuple(problem.start.tolist()), goal=tuple(problem.goal.tolist()))
