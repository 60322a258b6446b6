"""Protocol ``plans``: a problem that pictures show in part, planned by all arms of a unit."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cspace.plan import load_kernels
from cspace.planning.paths import length_rad, spaced
from cspace.planning.search import find_paths
from cspace.query import DEFAULT_PATHS, AlternativePath
from cspace.simulator import Checker, Problem, ProblemRequest, ValidityChecker
from cspace.simulator import Taken as Unseen
from cspace.worlds import checker_of, partly_seen, picture_file_of
from services.evaluator.benchmark.arms import CONNECT, PlanArm, Setting, Unit
from services.evaluator.benchmark.runs import PLAN_COLUMNS, Row
from services.evaluator.benchmark.samples import state_check_s
from services.evaluator.benchmark.sources import SourceSpec, opened_planners, plan_query
from services.planner.ompl_planner import solve
from services.planner.rrt_connect import solve_with_paths

Points = NDArray[np.float64]
# Status of a problem whose start or goal collides; it is left out.
NO_PROBLEM = "start or goal collides"
# Spacing of the states at which a path is checked, and at which its unseen share is measured.
LOOK_RAD, UNSEEN_RAD = 0.01, 0.1
_MESH_STATES, _REPEATS = 200, 3


def plan_units(
    problems: Mapping[str, int],
    pictures: Sequence[int],
    runs: int,
    arms: Sequence[PlanArm],
    folder: Path | None = None,
) -> Iterator[Unit]:
    """Every problem by every number of pictures, and without pictures for the arms that need none.

    Args:
        problems: number of each family.
        pictures: numbers by which each is seen.
        runs: searches with exact checks of each problem.
        arms: that are compared.
        folder: of problems that do not ship.
    """
    for family, count in problems.items():
        for index, seen_by in product(range(count), (0, *pictures)):
            own = [arm for arm in arms if arm.pictured == (seen_by > 0)]
            todo = tuple((arm, run) for arm in own for run in range(runs if arm.checked else 1))
            yield Unit(family, index, todo, seen_by, folder)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The paths of an arm before any exact check.

    Args:
        paths: the arm's choice first.
        status: ``solved``, ``refused`` or ``timeout``.
        confidence: of the first; None where no model was asked.
        search_s: time of the search.
        score_s: time of the model.
        request_s: all of it.
    """

    paths: tuple[AlternativePath, ...] = ()
    status: str = ""
    confidence: float | None = None
    search_s: float = 0.0
    score_s: float = 0.0
    request_s: float = 0.0

    @property
    def times(self) -> Row:
        """Their columns."""
        return {"search_s": self.search_s, "score_s": self.score_s, "request_s": self.request_s}


class PlanWorker:
    """Runs units in one process; the models stay open as long as it exists.

    Raises:
        SamplerError: a model does not answer.
    """

    def __init__(self, setting: Setting, specs: Sequence[SourceSpec]) -> None:
        self._setting, self._open = setting, ExitStack()
        self._planners = self._open.enter_context(opened_planners(specs, setting.world))

    def run(self, unit: Unit) -> list[Row]:
        """The rows of a unit; nothing in them depends on another unit.

        Raises:
            SamplerError: a model does not answer.
        """
        setting, seen = self._setting, partly_seen(self._setting.world)
        request = ProblemRequest(setting.split, setting.seed, setting.aim, unit.folder, setting.held)
        problem = seen.problem(request, unit.family, unit.index, max(1, unit.pictures))
        if problem is None:
            nothing: Row = {"status": NO_PROBLEM, "solved": False}
            return [self._row(unit, arm, run, Found().times | nothing) for arm, run in unit.todo]
        picture, world = picture_file_of(problem.scenario), problem.scenario.world
        image, truth = world.read_picture(picture), checker_of(problem.scenario)
        mesh_checker = seen.mesh_checker(problem, unit.folder)

        # Arms with the same model, or the same view of unseen space, share its paths.
        @cache
        def found(sampler: str | None, unseen: Unseen | None) -> Found:
            if sampler is not None:
                query = plan_query(problem, setting.seed, setting.plan_limit_s, DEFAULT_PATHS)
                plan, request_s = self._planners[sampler].plan(picture, query, world)
                confidence = plan.confidence if plan.status == "solved" else None
                times = 1e-3 * plan.search_ms, 1e-3 * plan.score_ms, request_s
                return Found(plan.alternatives, plan.status, confidence, *times)
            return (
                Found()
                if unseen is None
                else _searched(seen.checkers(problem, image, unseen), problem, setting)
            )

        @cache
        def prices() -> Row:
            spheres_s = state_check_s(problem, setting.range_rad, setting.resolution_rad)
            mesh_s = None if mesh_checker is None else _mesh_check_s(problem, mesh_checker)
            return {"state_check_s": spheres_s, "mesh_check_s": mesh_s}

        def share(rows: Points) -> Points:
            return seen.unseen(image, rows)

        rows = []
        for arm, run in unit.todo:
            paths = found(arm.sampler, arm.unseen)
            if arm.checked:
                result = _checked(None if arm == CONNECT else paths, problem, setting, unit.index, run)
                result |= prices()
            else:
                result = _evaluated(paths, truth, mesh_checker, share if unit.pictures else None)
            rows.append(self._row(unit, arm, run, paths.times | result))
        return rows

    def _row(self, unit: Unit, arm: PlanArm, run: int, measured: Row) -> Row:
        sources = partly_seen(self._setting.world).sources
        return dict.fromkeys(PLAN_COLUMNS) | measured | {
            "checked": arm.checked,
            "source": next((name for name, families in sources.items() if unit.family in families), ""),
            "family": unit.family,
            "problem": unit.index,
            "pictures": unit.pictures,
            "run": run,
            "arm": arm.name,
            "sampler": arm.sampler,
        }  # fmt: skip


def _searched(checkers: Sequence[Checker], problem: Problem, setting: Setting) -> Found:
    """Paths by what checkers take the scene to be, the shortest first."""
    space = problem.space
    load_kernels(checkers[0], problem.start, UNSEEN_RAD)
    began, until_s = time.perf_counter(), time.thread_time() + setting.plan_limit_s
    found = find_paths(checkers, problem.start, problem.goal, DEFAULT_PATHS, setting.seed, until_s)
    spent_s = time.perf_counter() - began
    paths = sorted(found.paths, key=lambda path: length_rad(path, space))
    alternatives = tuple(
        AlternativePath(path, 1.0, np.ones(len(path) - 1, dtype=np.float32)) for path in paths
    )
    status = "solved" if alternatives else "timeout" if found.late else "refused"
    return Found(alternatives, status, None, spent_s, 0.0, spent_s)


def _evaluated(
    found: Found,
    truth: Checker,
    mesh_checker: ValidityChecker | None,
    unseen: Callable[[Points], Points] | None,
) -> Row:
    """An arm's choice in the true scene.

    Args:
        found: by the arm.
        truth: the scene itself.
        mesh_checker: by meshes; None where these are not installed.
        unseen: share of the arm that pictures do not show, at (n, d) rad; None without pictures.
    """
    result: Row = {"status": found.status, "solved": bool(found.paths)}
    if not found.paths:
        return result
    path, space = found.paths[0].path, truth.space
    states = spaced(path, space, LOOK_RAD)
    return result | {
        "confidence": found.confidence,
        "clearance_m": float(truth.clearance(states).min()),
        "meshes_free": None if mesh_checker is None else bool(mesh_checker.valid_batch(states).all()),
        "unseen": None if unseen is None else float(unseen(spaced(path, space, UNSEEN_RAD)).mean()),
        "length_rad": length_rad(path, space),
    }


def _checked(found: Found | None, problem: Problem, setting: Setting, index: int, run: int) -> Row:
    """A search with exact checks that begins with the paths; without any where they are None."""
    settings = setting.planner(None, index, run)
    result = solve(problem, settings) if found is None else solve_with_paths(problem, settings, found.paths)
    return {
        "status": str(result.reason),
        "solved": result.solved,
        "length_rad": float(result.length_rad) if result.solved else None,
        "as_is": result.solved and result.iterations == 0,
        "state_checks": result.state_checks,
        "edge_checks": result.edge_checks,
        "iterations": result.iterations,
        "solve_s": result.solve_time_s,
    }


def _mesh_check_s(problem: Problem, mesh_checker: ValidityChecker) -> float:
    """Seconds for one configuration by meshes, free by spheres; the fastest of some loops."""
    sampled = problem.space.sample_uniform(np.random.default_rng(0), 8 * _MESH_STATES)
    rows = sampled[checker_of(problem.scenario).valid_batch(sampled)][:_MESH_STATES]
    taken = []
    for _ in range(_REPEATS):
        began = time.perf_counter()
        mesh_checker.valid_batch(rows)
        taken.append(time.perf_counter() - began)
    return min(taken) / len(rows)
