"""What the routes of pictures share: the scene of a request, the model that answers, and what answers say."""

import io
import json
import re
import time
from collections.abc import Awaitable, Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, lru_cache
from typing import Annotated, Any, Self

import numpy as np
from anyio import to_thread
from fastapi import Depends, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field, WithJsonSchema, model_validator

from cspace.errors import CspaceError, InputError
from cspace.query import is_digest
from cspace.view_file import View, check_ages, is_view, unstamped
from cspace.world import Finding, World
from cspace.worlds import robot_digest
from cspace_client.wire import (
    DIGEST,
    MAX_EXPLAINED,
    MAX_JOINTS,
    MAX_SAMPLES,
    JointSpaceInfo,
    KnownFields,
    ModelInfo,
    Number,
    Pictures,
    PictureWarning,
    PlanQuery,
    RobotReference,
    SampleQuery,
    ScenarioInfo,
    ViewFields,
)
from inference_api.request_body import body_of
from inference_api.served_models import Models, ModelStore, ServedModel
from services.names import ALIAS_CHAMPION, PATH_MODEL_NAME, model_of
from services.registry.entities import ModelReference

NPY = "application/x-npy"
# Proxies take 4 KiB of headers.
MAX_WARNINGS = 2048
REQUEST_ID_HEADER = {
    "X-Request-ID": {
        "description": "The client's own, or one that the server chose; every answer carries it.",
        "schema": {"type": "string"},
    }
}
_MODEL_HEADERS = {
    "X-Model-Name": "Name of the model that answered.",
    "X-Model-Version": "Its number in the registry, 0 for the shipped model.",
    "X-Model-Digest": "SHA-256 of the bundle's sums.",
    "X-Robot": "`robot` of the model.",
    "X-Alias-Confirmed": "`alias_confirmed` of the model, `true` or `false`.",
    "X-Joint-Space": "`joint_space` of the JSON answer, as JSON.",
    "X-Novelty": "`scenario.novelty` of the JSON answer, where the model estimates it.",
    "X-Warnings": "`warnings` of the JSON answer, as JSON; of many the last ones have an empty message.",
}


class SceneFields(ViewFields):
    """What shows the scene, and the model that is asked."""

    image: Pictures = Field(
        description="A square PNG, or 1 to 4 depth pictures: 16-bit PNG of mm, float32 TIFF or `.npy` of m."
    )
    model: str | None = Field(
        None,
        max_length=300,
        description="`name` (its champion), `name@alias`, `name/version` or `pretrained`; "
        "absent, the default model if it fits the request, else the only one that does.",
    )
    robot: RobotReference | None = Field(
        None, description="Digest of the robot that is planned for; without `model` also its name."
    )

    @model_validator(mode="after")
    def _name_without_model(self) -> Self:
        if self.robot is not None and self.model is not None and not re.fullmatch(DIGEST, self.robot):
            raise ValueError("robot is a digest where a model is named")
        return self


class SampleRequest(SampleQuery, SceneFields):
    """A request for samples."""


class PlanRequest(PlanQuery, SceneFields):
    """A request for a path."""


_Row = Annotated[list[Number], Field(min_length=1, max_length=MAX_JOINTS, fail_fast=True)]
_ROWS = {"type": "array", "items": {"type": "array", "items": {"type": "number"}}, "maxItems": MAX_SAMPLES}
ConfigurationRows = Annotated[
    bytes | Annotated[list[_Row], Field(min_length=1, max_length=MAX_SAMPLES, fail_fast=True)],
    WithJsonSchema(_ROWS),
]


class ValidityRequest(SceneFields):
    """A request for the confidence of configurations."""

    configurations: ConfigurationRows = Field(
        description="(n, joints) rad: JSON, or in a form a `.npy` file."
    )
    explain: bool = Field(default=False, description=f"Say `why`; at most {MAX_EXPLAINED} rows.")


class BeliefRequest(SceneFields):
    """A request for the probability that something is in each cell of space."""


class DoctorRequest(SceneFields):
    """A request for a diagnosis of pictures, cameras and state."""


@cache
def served_for(kind: type[SceneFields]) -> Callable[..., Awaitable[ServedModel]]:
    """A dependency: the model that a request names, loaded before it waits for a place to compute."""

    async def resolve(request: Annotated[Any, Depends(body_of(kind))], models: Models) -> ServedModel:
        if request.model is not None:
            return await models.resolve(ModelReference.parse(request.model))
        if request.robot is not None and not is_digest(request.robot):
            return await models.resolve(ModelReference.parse(model_of(request.robot)))
        served = await models.resolve(ModelReference.parse(models.model_name))
        if _fits(served.bundle.spec.world, request):
            return served
        names = await to_thread.run_sync(_fitting, models, request)
        if len(names) > 1:
            raise InputError(
                "several models fit the request, and the default model does not",
                expected=f"model, one of {', '.join(names)}",
                got="none",
            )
        # Where none fits, the default model says why it does not.
        return await models.resolve(ModelReference.parse(names[0])) if names else served

    return resolve


def _fits(world: World, request: SceneFields) -> bool:
    """Whether models of a world take a request's pictures and joints, as far as the request tells."""
    takes_depth = world.sensor.extent_m is None
    if takes_depth != (bool(request.camera) or is_view(request.image[0])):
        return False
    if is_digest(request.robot) and request.robot != robot_digest(world):
        return False
    state, rows = request.state or [], getattr(request, "configurations", b"")
    given = [getattr(request, "start", None), getattr(request, "goal", None), *rows[:1], state, *state]
    return all(len(one) == world.dim for one in given if isinstance(one, list) and _is_row(one))


def _is_row(values: list[Any]) -> bool:
    return bool(values) and isinstance(values[0], int | float)


def _fitting(models: ModelStore, request: SceneFields) -> list[str]:
    """Champions that fit a request, and shipped models of robots without one, by name."""
    found: dict[str, str] = {}
    for version in models.listing():
        if ALIAS_CHAMPION in version.aliases and not version.name.endswith(PATH_MODEL_NAME):
            with suppress(CspaceError):
                bundle = models.loaded(version) or models.get(ModelReference(version.name)).bundle
                if _fits(bundle.spec.world, request):
                    found[version.name] = bundle.robot
    shipped = [one for one in models.shipped if _fits(one.spec.world, request)]
    return [*found, *(one.name for one in shipped if robot_digest(one.spec.world) not in found.values())]


def robot_of(request: SceneFields) -> str | None:
    """The digest of the robot that is planned for; None where any will do, or a name has chosen the model."""
    return request.robot if is_digest(request.robot) else None


def has_known(request: SceneFields) -> bool:
    """Whether anything is known beside the pictures."""
    return any(getattr(request, name) for name in KnownFields.model_fields)


def view_of(request: SceneFields) -> View:
    """The pictures of a request and what goes with them, without the cameras' stamps; nothing is decoded.

    Raises:
        ImageError: a picture is too old or from the future.
        InputError: there are several pictures, or a unit of depths, and no camera; or an age and no stamp.
    """
    known = {name for name in KnownFields.model_fields if getattr(request, name)}
    if request.camera or request.state is not None or known:
        view = View(
            request.image,
            [one.model_dump(exclude_unset=True) for one in request.camera],
            request.state,
            request.depth_scale_m,
            request.model_dump_json(include=known, exclude_unset=True).encode() if known else None,
        )
    elif request.depth_scale_m is not None:
        raise InputError(
            "depth_scale_m comes without a camera",
            expected="it beside camera, for depth pictures; a view file has it inside",
            got=f"{request.depth_scale_m:g}",
        )
    elif len(request.image) > 1:
        raise InputError(
            "image is repeated",
            expected="one, or a camera for each",
            got=f"{len(request.image)} without cameras",
        )
    else:
        view = View.of(request.image[0])
    cameras, stamps = unstamped(view.cameras)
    if request.max_age_s is not None:
        check_ages(stamps or [None], request.max_age_s, time.time())
    return replace(view, cameras=cameras)


def about(served: ServedModel, novelty: float | None, warnings: list[PictureWarning]) -> dict[str, Any]:
    """What every answer about pictures says of them and of the model."""
    return {
        "scenario": ScenarioInfo(novelty=novelty),
        "warnings": warnings,
        "joint_space": JointSpaceInfo(**served.bundle.spec.world.space.to_dict()),
        "model": model_info(served),
    }


def model_info(served: ServedModel) -> ModelInfo:
    """The model that answered."""
    return ModelInfo(
        name=served.name,
        version=served.version,
        alias=served.alias,
        run_id=served.run_id,
        digest=served.bundle.digest,
        fallback=served.fallback,
        robot=served.bundle.robot,
        alias_confirmed=served.confirmed,
    )


def warnings_of(findings: Iterable[Finding]) -> list[PictureWarning]:
    """Findings as answers carry them, each code once."""
    once = {one.code: one for one in findings}
    return [
        PictureWarning(code=one.code, message=one.message, pictures=list(one.pictures))
        for one in once.values()
    ]


def json_response(answer: BaseModel) -> Response:
    """An answer that was made here, and is not validated again."""
    return Response(answer.model_dump_json(), media_type="application/json")


async def _prefers_npy(request: Request) -> bool:
    """Whether an ``Accept`` header ranks ``.npy`` above JSON; it has to name it."""
    accept = request.headers.get("accept", "")
    if NPY not in accept.lower():
        return False
    ranks = {NPY: 0.0, "application/json": 0.0}
    for entry in accept.split(","):
        media_type, *parameters = (part.strip().lower() for part in entry.split(";"))
        if media_type in ranks:
            ranks[media_type] = max(ranks[media_type], _quality(parameters))
    return ranks[NPY] > 0.0 and ranks[NPY] >= ranks["application/json"]


WantsNpy = Annotated[bool, Depends(_prefers_npy)]


def _quality(parameters: Sequence[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                return float(value)
            except ValueError:
                return 0.0
    return 1.0


def npy_response(
    array: NDArray[Any],
    served: ServedModel,
    novelty: float | None,
    warnings: Sequence[PictureWarning],
    timing: BaseModel,
    headers: dict[str, str],
) -> Response:
    """An array as a float32 ``.npy``; headers tell of the model, the picture and the rest."""
    found = np.ascontiguousarray(array, dtype="<f4")
    spent = ", ".join(f"{name};dur={value:.3f}" for name, value in timing.model_dump().items())
    headers = {
        "X-Model-Name": served.name,
        "X-Model-Version": str(served.version),
        "X-Model-Digest": served.bundle.digest,
        "X-Robot": served.bundle.robot,
        "X-Alias-Confirmed": "true" if served.confirmed else "false",
        "X-Joint-Space": json.dumps(served.bundle.spec.world.space.to_dict(), separators=(",", ":")),
        "X-Warnings": _warnings_text(warnings),
        "Server-Timing": spent,
        **({} if novelty is None else {"X-Novelty": f"{novelty:.6g}"}),
        **headers,
    }
    return Response(npy_head(found.shape) + found.tobytes(), headers=headers, media_type=NPY)


@lru_cache(maxsize=64)
def npy_head(shape: tuple[int, ...]) -> bytes:
    """What stands before the numbers in the ``.npy`` of a float32 array in C order."""
    buffer = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, described)
    return buffer.getvalue()


def _warnings_text(warnings: Sequence[PictureWarning]) -> str:
    """ASCII JSON of at most :data:`MAX_WARNINGS` characters: the last ones lose their words."""
    rows = [one.model_dump() for one in warnings]
    for one in reversed(rows):
        if len(json.dumps(rows)) <= MAX_WARNINGS:
            break
        one["message"] = ""
    return json.dumps(rows, separators=(",", ":"))


def answer_responses(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """``responses`` of a route that answers a question about a picture with JSON."""
    success = {"description": "The answer.", "model": model, "headers": REQUEST_ID_HEADER}
    return {200: success}


def npy_responses(
    model: type[BaseModel], array: str, headers: dict[str, str]
) -> dict[int | str, dict[str, Any]]:
    """``responses`` of a route that answers with JSON, or with an array and the rest in headers."""
    described = {
        name: {"description": f"{text} With `Accept: {NPY}` only.", "schema": {"type": "string"}}
        for name, text in (_MODEL_HEADERS | headers).items()
    }
    return answer_responses(model) | {
        200: {
            "description": "JSON, or a `.npy`.",
            "model": model,
            "content": {NPY: {"schema": {"type": "string", "format": "binary", "description": array}}},
            "headers": described | REQUEST_ID_HEADER,
        }
    }
