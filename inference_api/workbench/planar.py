"""Scenes of discs for the page: their picture, and what truly collides."""

import base64
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cspace.errors import InputError
from cspace.simulator import Checker, Simulator, Split
from cspace.world import Scene, World
from cspace.worlds import read_world, simulator_of
from inference_api.limits import ComputePlace
from inference_api.request_body import body_of
from inference_api.served_models import Models
from services.registry.entities import ModelReference

# Free ones of these are covered or not: two percent of accuracy, in a few ms.
_REFERENCES = 800
# Samples at a time, which bounds the memory.
_CHUNK = 256
# Finer than planners check, because a person looks at the result.
_RESOLUTION_RAD = 0.005
# A world of given scenes has at least one disc: this one is out of reach.
_NOWHERE = (1e6, 1e6, 1e-3)

Number = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
Radius = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
Row = Annotated[list[Number], Field(min_length=1, max_length=64)]

router = APIRouter(prefix="/workbench", include_in_schema=False)


class SceneRequest(BaseModel):
    """Discs (x, y, radius in m) among which a model's robot stands, and what is checked against them."""

    model_config = ConfigDict(extra="forbid")

    model: Annotated[str, Field(max_length=300)] | None = None
    discs: Annotated[list[tuple[Number, Number, Radius]], Field(max_length=64, fail_fast=True)]
    cells: Annotated[int, Field(ge=8, le=160)] = 96
    at: Row | None = None
    configurations: Annotated[list[Row], Field(max_length=2000, fail_fast=True)] = []
    path: Annotated[list[Row], Field(max_length=500, fail_fast=True)] = []


class PictureAnswer(BaseModel):
    """The picture as the API takes it: base64 of a PNG."""

    image: str


class TruthAnswer(BaseModel):
    """The ground truth of a scene.

    Args:
        cells: along each of the first two joints.
        free: base64 of one bit a cell, most significant first, joint 1 the slower axis; the other joints
            stand as in ``at``.
        sample_free: of each configuration.
        precision: share of the configurations that are free; None without any.
        coverage: share of the free space within the evaluator's radius of a free configuration.
        path_free: of each edge of the path; None without a path.
    """

    cells: int
    free: str
    sample_free: list[bool]
    precision: float | None
    coverage: float | None
    path_free: list[bool] | None


@dataclass(frozen=True)
class DiscScene:
    """A request, and its scene in a world that holds no other."""

    request: SceneRequest
    world: World
    simulator: Simulator
    scene: Scene

    def rows(self, field: str) -> NDArray[np.float64]:
        """The configurations in a field, (n, d) rad, within the joint limits."""
        rows, dim = getattr(self.request, field), self.world.dim
        if any(len(row) != dim for row in rows):
            raise InputError(
                f"{field} does not fit the robot", expected=f"{dim} angles for each configuration"
            )
        values = np.array(rows, dtype=np.float64).reshape(-1, dim)
        return self.world.space.admitted(values, f"{field} lies outside the robot's limits")


async def _scene_of(
    request: Annotated[SceneRequest, Depends(body_of(SceneRequest, "application/json"))], models: Models
) -> DiscScene:
    served = await models.resolve(ModelReference.parse(request.model or models.model_name))
    world = served.bundle.spec.world
    if world.kind != "planar":
        raise InputError("the model is of another kind of world", expected="a planar one", got=world.kind)
    scenes = {"train": [], "held_out": [[list(disc) for disc in request.discs or [_NOWHERE]]]}
    own = read_world(world.to_dict() | {"scenes": scenes})
    simulator = simulator_of(own)
    return DiscScene(request, own, simulator, simulator.scene(np.random.default_rng(0), Split.TEST, 0))


Discs = Annotated[DiscScene, Depends(_scene_of)]


@router.post("/picture")
def picture(discs: Discs, place: ComputePlace) -> PictureAnswer:
    """The picture of a scene, as the training draws it."""
    place.check_cancelled()
    return PictureAnswer(image=base64.b64encode(discs.simulator.picture_file(discs.scene)).decode())


@router.post("/truth")
def truth(discs: Discs, place: ComputePlace) -> TruthAnswer:
    """Collision regions of a scene, and whether samples and a path are free."""
    checker, samples, path = (
        discs.simulator.checker(discs.scene),
        discs.rows("configurations"),
        discs.rows("path"),
    )
    free = checker.valid_batch(_grid(discs)) if discs.world.dim > 1 else np.ones(0, np.bool_)
    place.check_cancelled()
    good = checker.valid_batch(samples) if len(samples) else np.zeros(0, np.bool_)
    return TruthAnswer(
        cells=discs.request.cells,
        free=base64.b64encode(np.packbits(free).tobytes()).decode(),
        sample_free=good.tolist(),
        precision=float(np.mean(good)) if len(good) else None,
        coverage=_coverage(discs.simulator, checker, samples[good]) if len(samples) else None,
        path_free=checker.edge_batch(path[:-1], path[1:], _RESOLUTION_RAD).tolist()
        if len(path) > 1
        else None,
    )


def _grid(discs: DiscScene) -> NDArray[np.float64]:
    """Centres of cells over the first two joints, joint 1 the slower axis, (cells^2, d) rad."""
    space, cells = discs.world.space, discs.request.cells
    at = np.zeros(space.dim)
    if discs.request.at is not None:
        if len(discs.request.at) != space.dim:
            raise InputError("at does not fit the robot", expected=f"{space.dim} angles")
        at = space.admitted(np.array([discs.request.at]), "at lies outside the robot's limits")[0]
    low, high = np.asarray(space.lower)[:2], np.asarray(space.upper)[:2]
    first, second = (low + np.outer((np.arange(cells) + 0.5) / cells, high - low)).T
    grid = np.tile(at, (cells**2, 1))
    grid[:, 0], grid[:, 1] = np.repeat(first, cells), np.tile(second, cells)
    return grid


def _coverage(simulator: Simulator, checker: Checker, samples: NDArray[np.float64]) -> float | None:
    """The evaluator's measure, on fewer references."""
    anywhere = checker.space.sample_uniform(np.random.default_rng(0), _REFERENCES)
    free = anywhere[checker.valid_batch(anywhere)]
    if not len(free):
        return None
    covered = np.zeros(len(free), dtype=np.bool_)
    for chunk in np.array_split(samples, -(-len(samples) // _CHUNK) or 1):
        near = checker.space.distance(chunk[None], free[:, None]) <= simulator.measures.coverage_radius_rad
        covered |= near.any(axis=1)
    return float(np.mean(covered))
