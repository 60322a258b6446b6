"""A planner and a source of learned samples put together: one batch before the search, none during it."""

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
from services.planner.rrt_connect import order_along
from services.planner.samples import SampleBatch, SampleSource
from services.planner.settings import RRT_CONNECT, PlannerSettings
from services.scene_files import read_scene_file

DEFAULT_SAMPLES = 300
PAPER_SCHEDULE = (0.0, 0.25, 0.5, 1.0)
"""The epsilon schedule of algorithm 3 in the MultiWGAN-GP paper, of which the paper gives no values."""
# The percentile of novelty up to which a picture is taken for one like those of the training.
ORDINARY = 0.95


@dataclass(frozen=True, slots=True)
class SampleRequest:
    """What is asked of a source of samples for one problem, and how its answer is taken.

    Args:
        query: without start and goal, which are the problem's.
        model: ``name``, ``name@alias``, ``name/version`` or ``pretrained``; None for the source's default.
        with_ends: whether start and goal are sent, as path models require and others refuse.
        ordered: whether the planner takes the samples along the path through them, from the start on.
        or_uniform: whether uniform samples do where there is no such model.
    """

    query: SampleQuery
    model: str | None = None
    with_ends: bool = False
    ordered: bool = False
    or_uniform: bool = False

    def of_robot(self, world: World, name: str | None = None) -> "SampleRequest":
        """The request with the model of a robot of one's own where it names none.

        Args:
            world: its robot.
            name: the robot's, for its models; None for what its description calls it.

        Raises:
            ConfigError: the name is another robot's.
        """
        if self.model is not None or robot_digest(world) == robot_digest(default_world()):
            return self
        own = model_name(world, name or label(world), path=self.with_ends)
        return replace(self, model=own, or_uniform=True)


@dataclass(frozen=True, slots=True, eq=False)
class ApiPlan:
    """One problem solved with samples from a source, or without where there were none.

    Args:
        result: of the planner.
        batch: the samples; None when the source did not answer.
        unavailable: why there are none, in words; None when there are.
        uniform_share: of uniform samples mixed in, as the picture's novelty left it.
    """

    result: PlanResult
    batch: SampleBatch | None
    unavailable: str | None
    uniform_share: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One problem solved in three ways under one seed.

    Args:
        problem: that was solved.
        learned: with samples from the source.
        uniform: the same planner with OMPL's own uniform samples.
        connect: RRTConnect with uniform samples, the strongest stock baseline here.
    """

    problem: Problem
    learned: ApiPlan
    uniform: PlanResult
    connect: PlanResult


def plan_with_api(
    problem: Problem,
    source: SampleSource,
    settings: PlannerSettings,
    request: SampleRequest | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
    *,
    keep_tree: bool = False,
) -> ApiPlan:
    """Draw the picture, ask for one batch, solve; uniformly where the source does not answer.

    Args:
        problem: start and goal in a scenario.
        source: of samples, usually a :class:`services.planner.client.SamplingClient`.
        settings: of the planner.
        request: what is asked of the source; None for 300 samples with the planner's seed.
        uniform_share: of uniform samples mixed in, raised where the picture is like none the model knows.
        keep_tree: whether the result holds the search tree.

    Raises:
        SamplerError: the source refused the request; of this kind, SamplerAnswerError: its answer can not be
            used.
        PlanningError: the planner takes no samples.
    """
    request = request or SampleRequest(SampleQuery(DEFAULT_SAMPLES, settings.seed))
    batch, unavailable = None, None
    try:
        batch = request_samples(problem, source, request)
    except SamplerUnavailableError as error:
        unavailable = str(error)
    except SamplerModelError:
        if not request.or_uniform:
            raise
        unavailable = f"there is no {request.model} yet"
    samples = None
    if batch is not None:
        samples, uniform_share = batch.samples, raised_share(uniform_share, batch.novelty)
        if request.ordered:
            space = problem.space
            samples = samples[order_along(samples, problem.start, problem.goal, space)]
    result = solve(problem, settings, samples, uniform_share, keep_tree=keep_tree)
    return ApiPlan(result, batch, unavailable, uniform_share)


def plan_scene(path: str | Path, api: str | None = None, settings: PlannerSettings | None = None) -> ApiPlan:
    """Solve the problem of a scene file with samples from an API, of the robot's own model.

    Args:
        path: of the scene file; see :mod:`services.scene_files`.
        api: address of the inference API, None for the one that the shell means; uniform samples where it
            does not answer or has no such model.
        settings: of the planner.

    Raises:
        ScenarioError: the file does not fit, or holds no problem.
        SamplerError: the API refused the request.
    """
    scene, settings = read_scene_file(Path(path)), settings or PlannerSettings()
    request = SampleRequest(SampleQuery(DEFAULT_SAMPLES, settings.seed)).of_robot(scene.world, scene.name)
    with SamplingClient(api or usual_api()) as client:
        return plan_with_api(scene.problem(), client, settings, request)


def raised_share(uniform_share: float, novelty: float | None) -> float:
    """The share of uniform samples for a picture of some novelty, all of them for one like no other.

    Up to the 95th percentile a picture is an ordinary one; from there the share rises in proportion, so that
    a planner leans on a model the less, the less the model can know.

    Args:
        uniform_share: for ordinary pictures, 0 to 1.
        novelty: 0 to 1; None where it is not known, which changes nothing.
    """
    beyond = max(0.0, ((novelty or 0.0) - ORDINARY) / (1.0 - ORDINARY))
    return uniform_share + (1.0 - uniform_share) * beyond


def request_samples(problem: Problem, source: SampleSource, request: SampleRequest) -> SampleBatch:
    """One batch for a problem's picture.

    Raises:
        SamplerUnavailableError: the source does not answer.
        SamplerError: it refused the request, or its samples are those of another robot.
    """
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


def compare_with_api(
    problem: Problem,
    source: SampleSource,
    settings: PlannerSettings,
    request: SampleRequest | None = None,
    uniform_share: float = DEFAULT_UNIFORM_SHARE,
) -> Comparison:
    """The problem with learned samples, with uniform ones, and with RRTConnect; the trees are kept.

    Raises:
        SamplerError: as :func:`plan_with_api`, and so the rest.
        PlanningError: the planner takes no samples.
    """
    learned = plan_with_api(problem, source, settings, request, uniform_share, keep_tree=True)
    uniform = solve(problem, settings, keep_tree=True)
    connect = solve(problem, replace(settings, planner=RRT_CONNECT), keep_tree=True)
    return Comparison(problem, learned, uniform, connect)
