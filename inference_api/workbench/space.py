"""Scenes in space: drawn by a seed, seen by cameras that one turns, with what holds in them in truth."""

import base64
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.errors import InputError
from cspace.png import encode_png
from cspace.simulator import Problem, Split
from cspace.world import Scene, World
from cspace.worlds import simulator_of
from inference_api.models.served import ServedModel
from inference_api.turns import costs
from inference_api.turns.turns import Turn
from inference_api.workbench.benchmark import benchmark_families, benchmark_problem
from inference_api.workbench.space_faces import faces_of
from inference_api.workbench.space_schemas import SpaceAnswer, SpaceRequest
from inference_api.workbench.truth import path_of, rows_of, states_on, telling, way_truth
from services.registry.references import ModelReference

_SPATIAL = "spatial"
# Of previews: what is farther away is as dark as what nobody sees.
_FAR_MM = 2500.0


@dataclass(frozen=True, slots=True, eq=False)
class SpaceQuestion:
    """A scene in space and what is held against it; an :class:`~inference_api.pages.exchange.Question`.

    Args:
        asked: which scene, and what is held against it.
        reference: the model whose arm it is.
        folder: of MotionBenchMaker's problems that do not ship; None without them.
    """

    asked: SpaceRequest
    reference: ModelReference
    folder: Path | None = None

    def answer(self, served: ServedModel, turn: Turn) -> Response:
        """Draw, look and check.

        Raises:
            CspaceError: as the contract's table of errors.
        """
        asked, world = self.asked, served.bundle.spec.world
        if world.kind != _SPATIAL:
            raise InputError(
                "the model is of another kind of world", expected=f"a {_SPATIAL} one", got=world.kind
            )
        samples, path = rows_of("configurations", asked.configurations, world), path_of(asked.path, world)
        turn.spend(costs.rows_of(drawn=len(samples) + states_on(path, world), searches=True))
        with telling():
            names = simulator_of(world).families.names + benchmark_families(world)
            family = asked.family or names[0]
            problem = _problem(world, family, asked.seed, self.folder)
            turn.between()
            scene = _seen(problem.scenario, asked)
            body = _told(scene, problem, family, names, samples, path)
        return Response(body.model_dump_json(), media_type="application/json")


@lru_cache(maxsize=8)
def _problem(world: World, family: str, seed: int, folder: Path | None) -> Problem:
    """Asked for again with every turn of a camera."""
    if family in benchmark_families(world):
        return benchmark_problem(world, family, seed, folder)
    return simulator_of(world).problem(family, Split.DEMO, seed)


def _seen(scene: Scene, asked: SpaceRequest) -> Scene:
    """The scene with other cameras and the arm elsewhere, where that is asked for."""
    found: Any = scene
    if asked.state is not None:
        found = replace(found, state=tuple(rows_of("state", (asked.state,), found.world)[0].tolist()))
    if asked.cameras is not None:
        like = found.cameras[0]
        with telling("cameras"):
            found = replace(found, cameras=tuple(replace(like, pose=pose) for pose in asked.cameras))
    return cast("Scene", found)


def _told(
    scene: Scene,
    problem: Problem,
    family: str,
    names: tuple[str, ...],
    samples: NDArray[np.float64],
    path: NDArray[np.float64],
) -> SpaceAnswer:
    simulator, found = simulator_of(scene.world), cast("Any", scene)
    checker, told = simulator.checker(scene), scene.to_dict()
    return SpaceAnswer(
        image=base64.b64encode(simulator.picture_file(scene)).decode(),
        previews=[base64.b64encode(_preview(one)).decode() for one in found.view().pictures],
        cameras=told["cameras"],
        faces=faces_of(told["obstacles"]),
        start=told["state"],
        goal=problem.goal.tolist(),
        family=family,
        families=list(names),
        sample_free=checker.valid_batch(samples).tolist() if len(samples) else [],
        way=way_truth(checker, path) if len(path) > 1 else None,
    )


def _preview(depth_mm: NDArray[np.uint16]) -> bytes:
    """Grey, the nearer the lighter, black where nothing was read."""
    near = np.where(depth_mm > 0, np.clip(1.0 - depth_mm / _FAR_MM, 0.05, 1.0), 0.0)
    grey = np.round(255.0 * near).astype(np.uint8)
    return encode_png(np.repeat(grey[..., None], 3, axis=2))
