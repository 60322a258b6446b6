"""What the workbench's routes take and answer, as pydantic models; the contract does not know of them."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, Strict

from cspace.query import MAX_SEED
from inference_api.schemas import Expected, ModelFields, Seed
from services.registry.entities import ModelReference

MAX_LETTERS = 2**15
# A picture of joint 1 against joint 2 that is finer than anybody sees.
MAX_CELLS = 160
MAX_DISCS = 64
# What is on the page at once; the nearest sample of each reference is looked for among them.
MAX_SHOWN = 2_000

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Row = Annotated[tuple[Number, ...], Field(min_length=1, max_length=64), Strict(strict=False)]
_Radius = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
_Disc = Annotated[tuple[Number, Number, _Radius], Strict(strict=False)]
Discs = Annotated[
    Annotated[tuple[_Disc, ...], Field(max_length=MAX_DISCS), Strict(strict=False)],
    Expected(f"at most {MAX_DISCS} of x, y and radius in m, the radius above 0"),
]
Rows = Annotated[
    Annotated[tuple[Row, ...], Field(max_length=MAX_SHOWN), Strict(strict=False)],
    Expected(f"at most {MAX_SHOWN} arrays of angles in rad"),
]
_Family = Annotated[
    Annotated[str, Field(max_length=100)] | None,
    Expected("a family of the model's robot, or nothing for the first"),
]
_SceneSeed = Annotated[int, Field(ge=0, le=MAX_SEED), Expected(f"a whole number from 0 to {MAX_SEED}")]
_End = Annotated[Row, Expected("an angle in rad for each joint")]


class WorkbenchRequest(ModelFields):
    """A request of the page, in which an empty name is that of the default model."""

    def reference(self, default: str) -> ModelReference:
        """The model that is asked."""
        return ModelReference.parse(self.model or default)


class SceneRequest(WorkbenchRequest):
    """Which scene of a family is wanted."""

    family: _Family = None
    seed: _SceneSeed = 0


class TruthRequest(WorkbenchRequest):
    """A scene of discs, and what is held against it."""

    discs: Discs
    cells: Annotated[int, Field(ge=8, le=MAX_CELLS), Expected(f"a whole number from 8 to {MAX_CELLS}")] = 96
    at: Annotated[Row | None, Expected("an angle in rad for each joint")] = None
    configurations: Rows = ()
    path: Rows = ()


class SceneAnswer(BaseModel):
    """A problem of a family.

    Args:
        discs: x, y, radius in m.
        start: rad.
        goal: rad.
        family: whose it is.
        families: of the robot, the first one first.
        seed: it was drawn from.
    """

    discs: list[list[float]]
    start: list[float]
    goal: list[float]
    family: str
    families: list[str]
    seed: int


class PathCheck(BaseModel):
    """Whether a path is free.

    Args:
        free: all of it.
        edges: each piece of it.
        clearance_m: the least distance to what the robot collides with, at the path's points.
    """

    free: bool
    edges: list[bool]
    clearance_m: float


class TruthAnswer(BaseModel):
    """The ground truth of a scene.

    Args:
        cells: how many there are along each of the first two joints.
        free: base64 of one bit a cell, most significant first, joint 1 the slower axis; the other joints
            stand where ``at`` has them.
        sample_free: for each configuration.
        precision: share of the configurations that are free; None without any.
        coverage: share of free configurations, drawn evenly, with one of the free samples within
            ``radius_rad``.
        radius_rad: of coverage.
        path_verdict: of the path; None without one.
        families: that scenes can be generated of.
        timing_ms: of all of it.
    """

    cells: int
    free: str
    sample_free: list[bool]
    precision: float | None
    coverage: float | None
    radius_rad: float
    path_verdict: PathCheck | None
    families: list[str]
    timing_ms: dict[str, Any]


class FileRequest(WorkbenchRequest):
    """A scene file's text."""

    text: Annotated[
        str, Field(max_length=MAX_LETTERS), Expected(f"YAML or JSON of at most {MAX_LETTERS} letters")
    ]


MAX_ITERATIONS = 20_000
_MAX_PATHS = 8
_Paths = Annotated[
    Annotated[tuple[Rows, ...], Field(max_length=_MAX_PATHS), Strict(strict=False)],
    Expected(f"at most {_MAX_PATHS} paths of at most {MAX_SHOWN} configurations in all"),
]


class SearchRequest(WorkbenchRequest):
    """A problem among discs, a planner, and what it samples."""

    discs: Discs
    start: _End
    goal: _End
    planner: Annotated[Literal["RRT", "RRTConnect"], Expected("RRT or RRTConnect")]
    samples: Rows = ()
    paths: _Paths = ()
    seed: Seed = 0
    max_iterations: Annotated[
        int, Field(ge=1, le=MAX_ITERATIONS), Expected(f"a whole number from 1 to {MAX_ITERATIONS}")
    ] = 5000
    time_limit_s: Annotated[
        float, Field(ge=0.01, le=10.0, allow_inf_nan=False), Expected("a number from 0.01 to 10")
    ] = 5.0


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
        path_verdict: of the path, by the ground truth; None without one.
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
    path_verdict: PathCheck | None = None
