"""What the workbench asks of trees that grow among a scene's true discs, and is told, as types."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, Field, Strict

from inference_api.pages.schemas import RequestFields, Seed
from inference_api.workbench.truth_schemas import (
    DISCS_EXPECTED,
    MAX_SHOWN,
    MODEL_EXPECTED,
    Discs,
    Row,
    Rows,
    WayTruth,
)

MAX_ITERATIONS = 20_000
_MAX_WAYS = 8
_Ways = Annotated[tuple[Rows, ...], Field(max_length=_MAX_WAYS), Strict(strict=False)]


class SearchRequest(RequestFields):
    """A problem among discs, a planner, and what it draws."""

    EXPECTED: ClassVar[Mapping[str, str]] = {
        "model": MODEL_EXPECTED,
        "discs": DISCS_EXPECTED,
        "start": "an angle in rad for each joint",
        "goal": "an angle in rad for each joint",
        "planner": "RRT or RRTConnect",
        "samples": f"at most {MAX_SHOWN} arrays of angles in rad",
        "ways": f"at most {_MAX_WAYS} ways of at most {MAX_SHOWN} configurations in all",
        "seed": "unsigned 64 bit, as a number or in decimal",
        "max_iterations": f"a whole number from 1 to {MAX_ITERATIONS}",
        "time_limit_s": "a number from 0.01 to 10",
    }
    model: str = ""
    discs: Discs
    start: Row
    goal: Row
    planner: Literal["RRT", "RRTConnect"]
    samples: Rows = ()
    ways: _Ways = ()
    seed: Seed = 0
    max_iterations: Annotated[int, Field(ge=1, le=MAX_ITERATIONS)] = 5000
    time_limit_s: Annotated[float, Field(ge=0.01, le=10.0, allow_inf_nan=False)] = 5.0


class SearchAnswer(BaseModel):
    """What a planner has found, and what it took.

    Args:
        status: ``solved``; ``refused`` where an end collides; ``exhausted`` where the iterations were used
            up, ``timeout`` where the time was over.
        reason: in words, of what is not solved.
        path: from start to goal, rad; empty unless it is solved.
        length_rad: Euclidean length of the path.
        iterations: states that were drawn, free or not.
        edge_checks: motions that were checked.
        state_checks: states within them.
        learned_drawn: states that were given, not uniform.
        search_ms: wall time of the search alone.
        nodes: of the trees, rad.
        parents: of each node the one from which it was reached, -1 for roots.
        way: of the path, in truth; None without one.
    """

    status: Literal["solved", "refused", "exhausted", "timeout"]
    reason: str | None
    path: list[list[float]] = []
    length_rad: float = 0.0
    iterations: int = 0
    edge_checks: int = 0
    state_checks: int = 0
    learned_drawn: int = 0
    search_ms: float = 0.0
    nodes: list[list[float]] = []
    parents: list[int] = []
    way: WayTruth | None = None
