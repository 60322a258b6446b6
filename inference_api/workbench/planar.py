"""Scenes of discs for the page: drawn, read from files, checked against the ground truth, and searched.

Each raises CspaceError as the contract's table of errors. The planners are this project's own, compiled where
it counts: OMPL's hold the interpreter's lock while they search, and nobody else would be answered meanwhile.
"""

import base64
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.responses import JSONResponse, Response
from numpy.typing import NDArray

from cspace.errors import InputError, ScenarioError
from cspace.planning.paths import NOISE_RAD, AlongPaths, length_rad
from cspace.planning.rrt_connect import GOAL_BIAS, Grown, Growth, grow_connect, grow_rrt, sampled_states
from cspace.simulator import Checker, Simulator, Split
from cspace.world import World
from cspace.worlds import read_world, simulator_of
from inference_api.models.served import ServedModel
from inference_api.problem_types import FieldProblem, FieldsError, NoKernelsError
from inference_api.scheduler import Job
from inference_api.scheduler import rows_of as rows_cost
from inference_api.workbench.schemas import (
    MAX_SHOWN,
    FileRequest,
    PathCheck,
    SceneAnswer,
    SceneRequest,
    SearchAnswer,
    SearchRequest,
    TruthAnswer,
    TruthRequest,
)

_PLANAR = "planar"
# Free ones of these are covered or not: two percent of accuracy, in a few ms.
_REFERENCES = 800
# Samples at a time, so that memory stays small.
_CHUNK = 256
# Checks of a path for a person's eyes are finer than those of a planner.
_RESOLUTION_RAD = 0.005
# Of a path; ten times as long as any that a planner finds.
MAX_STATES = 100_000
# A scene without discs is one whose disc nobody reaches, for worlds of given scenes have one at least.
_NOWHERE = (1e6, 1e6, 1e-3)
# As the planner's command has it.
_UNIFORM_SHARE = 0.3
# What errors call a scene file, before the line.
_NAME = Path("the file")


def scene(request: SceneRequest, served: ServedModel, job: Job) -> Response:
    """A scene of a family."""
    # Draws that are not of the family are drawn again.
    job.spend(rows_cost(searches=True))
    world = planar(served.bundle.spec.world)
    with request_errors():
        simulator = simulator_of(world)
        names = simulator.families.names
        family = request.family or names[0]
        # Nothing of these scenes is used to train or to evaluate, so playing with them gives nothing away.
        problem = simulator.problem(family, Split.DEMO, request.seed)
        rows = simulator.arrays_of(problem.scenario)["discs"]
    # Scenes with fewer discs than the most repeat their last one.
    discs = list(dict.fromkeys(tuple(row) for row in rows.tolist()))
    body = SceneAnswer(
        discs=[list(disc) for disc in discs],
        start=problem.start.tolist(),
        goal=problem.goal.tolist(),
        family=family,
        families=list(names),
        seed=request.seed,
    )
    return Response(body.model_dump_json(), media_type="application/json")


def truth(request: TruthRequest, served: ServedModel, job: Job) -> Response:
    """What holds of a scene of discs: its free space, and whether samples and a path are free."""
    world = planar(served.bundle.spec.world)
    samples, path = rows_of("configurations", request.configurations, world), path_of(request.path, world)
    job.spend(rows_cost(rows=request.cells**2 + len(samples) + states_on(path, world)))
    began = time.perf_counter()
    with request_errors():
        simulator = simulator_of(among(world, request.discs))
        checker = simulator.checker(simulator.scene(np.random.default_rng(0), Split.TEST, 0))
        free = checker.valid_batch(_grid(world, request)) if world.dim > 1 else np.ones(0, np.bool_)
        job.check_cancelled()
        good = checker.valid_batch(samples) if len(samples) else np.zeros(0, dtype=np.bool_)
        covered = _coverage(simulator, checker, samples[good]) if len(samples) else None
        path_verdict = check_path(checker, path) if len(path) > 1 else None
    body = TruthAnswer(
        cells=request.cells,
        free=base64.b64encode(np.packbits(free).tobytes()).decode(),
        sample_free=good.tolist(),
        precision=float(np.mean(good)) if len(good) else None,
        coverage=covered,
        radius_rad=simulator.measures.coverage_radius_rad,
        path_verdict=path_verdict,
        families=list(simulator.families.names),
        timing_ms={"total": 1e3 * (time.perf_counter() - began)},
    )
    return Response(body.model_dump_json(), media_type="application/json")


def search(request: SearchRequest, served: ServedModel, job: Job) -> Response:
    """A planner's trees among discs, and the path that they found."""
    world = planar(served.bundle.spec.world)
    ends = world.space.bound(
        np.concatenate([rows_of("start", (request.start,), world), rows_of("goal", (request.goal,), world)])
    )
    samples = _given(request, world)
    with job.searching() as check_cancelled, request_errors():
        simulator = simulator_of(among(world, request.discs))
        checker = simulator.checker(simulator.scene(np.random.default_rng(0), Split.TEST, 0))
        free = checker.valid_batch(ends)
        if not free.all():
            reason = f"the {'goal' if free[0] else 'start'} collides"
            body = SearchAnswer(status="refused", reason=reason)
        else:
            measures = simulator.measures
            growth = Growth(
                measures.range_rad, measures.resolution_rad, request.time_limit_s, check_cancelled
            )
            body = _searched(request, checker, ends, samples, growth)
    return Response(body.model_dump_json(), media_type="application/json")


def scene_file(request: FileRequest, _: ServedModel, job: Job) -> Response:
    """A scene file as the command lines read it, with all that it leaves out, in JSON."""
    job.spend(rows_cost(searches=True))
    with request_errors():
        return JSONResponse(_scene_of(request.text))


@contextmanager
def request_errors() -> Iterator[None]:
    """Raises scenario errors as errors of the request.

    Raises:
        InputError: the scene cannot be.
        NoKernelsError: the packages of the extra ``workbench`` are not installed.
    """
    try:
        yield
    except ScenarioError as error:
        raise InputError(error.what, expected=error.expected, got=error.got, remedy=error.remedy) from error
    except ImportError as error:
        raise NoKernelsError(
            "this server has no ground truth",
            expected="the packages of the extra workbench",
            got=f"no {error.name or 'compiler'}",
            remedy="install them, or do without the ground truth",
        ) from error


def planar(world: World) -> World:
    """The world, where it is a planar one.

    Raises:
        InputError: it is not.
    """
    if world.kind != _PLANAR:
        raise InputError("the model is of another kind of world", expected=f"a {_PLANAR} one", got=world.kind)
    return world


def among(world: World, discs: tuple[tuple[float, float, float], ...]) -> World:
    """The same world with these discs as its only scene."""
    given = {"train": [], "held_out": [[list(disc) for disc in discs or (_NOWHERE,)]]}
    return read_world(world.to_dict() | {"scenes": given})


def rows_of(field: str, rows: tuple[tuple[float, ...], ...], world: World) -> NDArray[np.float64]:
    """Configurations as an array, (n, d) rad, within the limits of the joints that have some.

    Args:
        field: that they stand in.
        rows: angles in rad.
        world: of the robot.

    Raises:
        FieldsError: one is of another length, or outside.
    """
    wrong = next((len(row) for row in rows if len(row) != world.dim), None)
    if wrong is not None:
        raise wrong_field(field, f"{world.dim} angles", str(wrong))
    values = np.array(rows, dtype=np.float64).reshape(-1, world.dim)
    try:
        return world.space.admitted(values, f"{field} lies outside the robot's limits")
    except InputError as error:
        raise wrong_field(field, error.expected or "", error.got or "") from error


def path_of(rows: tuple[tuple[float, ...], ...], world: World) -> NDArray[np.float64]:
    """The field ``path`` as an array, (n, d) rad, of a bounded length.

    Raises:
        FieldsError: as :func:`rows_of`, or it is longer.
    """
    path = rows_of("path", rows, world)
    if (states := states_on(path, world)) > MAX_STATES:
        longest = f"a path of at most {MAX_STATES * _RESOLUTION_RAD:g} rad"
        raise wrong_field("path", longest, f"{states * _RESOLUTION_RAD:.6g}")
    return path


def states_on(path: NDArray[np.float64], world: World) -> float:
    """About how many states :func:`check_path` looks at."""
    steps = np.abs(world.space.difference(path[:-1], path[1:])).max(axis=1, initial=0.0)
    return float(steps.sum()) / _RESOLUTION_RAD


def wrong_field(field: str, expected: str, got: str) -> FieldsError:
    """The error for one field of a request."""
    return FieldsError([FieldProblem(field=field, expected=expected, got=got)])


def _grid(world: World, request: TruthRequest) -> NDArray[np.float64]:
    """Centres of cells over the first two joints, joint 1 the slower axis, (cells^2, d) rad."""
    at = rows_of("at", (request.at,), world)[0] if request.at else np.zeros(world.dim)
    low, high = (np.asarray(end[:2]) for end in (world.space.lower, world.space.upper))
    steps = (np.arange(request.cells) + 0.5) / request.cells
    first, second = (low[joint] + steps * (high - low)[joint] for joint in (0, 1))
    grid = np.tile(at, (request.cells**2, 1))
    grid[:, 0], grid[:, 1] = np.repeat(first, request.cells), np.tile(second, request.cells)
    return grid


def _coverage(simulator: Simulator, checker: Checker, samples: NDArray[np.float64]) -> float | None:
    """Share of free configurations with a sample nearby; the evaluator's measure, on fewer of them."""
    space = checker.space
    anywhere = space.sample_uniform(np.random.default_rng(0), _REFERENCES)
    free = anywhere[checker.valid_batch(anywhere)]
    if not len(free):
        return None
    if not len(samples):
        return 0.0
    radius = simulator.measures.coverage_radius_rad
    covered = np.zeros(len(free), dtype=np.bool_)
    for chunk in np.array_split(samples, -(-len(samples) // _CHUNK)):
        covered |= np.any(space.distance(chunk[None], free[:, None]) <= radius, axis=1)
    return float(np.mean(covered))


def check_path(checker: Checker, path: NDArray[np.float64]) -> PathCheck:
    """Whether a path (n, d) rad is free."""
    edges = checker.edge_batch(path[:-1], path[1:], _RESOLUTION_RAD)
    return PathCheck(
        free=bool(edges.all()),
        edges=edges.tolist(),
        clearance_m=float(np.min(checker.clearance(path))),
    )


def _given(request: SearchRequest, world: World) -> NDArray[np.float64] | None:
    """What is sampled before uniform states, (n, d) rad: samples as they are, or states around paths."""
    if not request.paths:
        return rows_of("samples", request.samples, world) if request.samples else None
    if sum(map(len, request.paths)) > MAX_SHOWN or not all(request.paths):
        raise wrong_field("paths", request.expected("paths"), f"{len(request.paths)} paths")
    paths = [rows_of("paths", path, world) for path in request.paths]
    along = AlongPaths(paths, world.space, np.random.default_rng(request.seed))
    return along.take(min(request.max_iterations, len(NOISE_RAD) * along.turn_rows))[0]


def _searched(
    request: SearchRequest,
    checker: Checker,
    ends: NDArray[np.float64],
    samples: NDArray[np.float64] | None,
    growth: Growth,
) -> SearchAnswer:
    # The stream of the planner's command, so that a seed and its samples give the same search there.
    rng = np.random.default_rng(np.random.SeedSequence(request.seed, spawn_key=(2,)))
    states, learned = sampled_states(checker.space, samples, _UNIFORM_SHARE, request.max_iterations, rng)
    if request.planner == "RRT":
        towards_goal = rng.random(len(states)) < GOAL_BIAS
        learned &= ~towards_goal
        found = grow_rrt(checker, ends[0], ends[1], states, towards_goal, growth)
    else:
        found = grow_connect(checker, ends[0], ends[1], states, growth)
    return _search_answer(request, checker, found, int(learned[: found.iterations].sum()))


def _search_answer(
    request: SearchRequest, checker: Checker, found: Grown, learned_drawn: int
) -> SearchAnswer:
    body = SearchAnswer(
        status="timeout" if found.timed_out else "exhausted",
        reason=f"no path was found within {request.max_iterations} iterations",
        iterations=found.iterations,
        edge_checks=found.edge_checks,
        state_checks=found.state_checks,
        learned_drawn=learned_drawn,
        search_ms=1e3 * found.time_s,
        nodes=found.nodes.round(4).tolist(),
        parents=found.parents.tolist(),
    )
    if found.path is not None:
        body.status, body.reason, body.path = "solved", None, found.path.tolist()
        body.length_rad, body.path_verdict = (
            length_rad(found.path, checker.space),
            check_path(checker, found.path),
        )
    elif found.timed_out:
        body.reason = f"no path was found within {request.time_limit_s:g} s"
    return body


def _scene_of(text: str) -> dict[str, Any]:
    # Brings packages that a server without the truth does not have.
    from services.scene_files import read_scene_text  # noqa: PLC0415

    # Arms in space are named, and looked for among files.
    found = read_scene_text(text.encode(errors="surrogatepass"), _NAME, ("planar",))
    if found.scene is None:
        raise InputError("the file holds no scene", expected="obstacles, an empty list for none", got="none")
    values = found.scene.to_dict()
    discs = [dict(zip(("x_m", "y_m", "radius_m"), row, strict=True)) for row in values["discs"]]
    ends = {"start": found.start, "goal": found.goal}
    return {"robot": values["robot"], "obstacles": discs} | {
        name: end.tolist() for name, end in ends.items() if end is not None
    }
