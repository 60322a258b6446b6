"""What the routes of pictures share: the scene of a request, the model that answers, and what answers say."""

import io
import json
import re
import time
from collections.abc import Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, lru_cache
from typing import Annotated, Any, Self

import numpy as np
from fastapi import Depends, Request
from fastapi.responses import Response
from numpy.typing import NDArray
from pydantic import BaseModel, Field, WithJsonSchema, model_validator

from cspace.bundle import Bundle
from cspace.errors import ImageError, InputError
from cspace.query import is_digest
from cspace.view_file import View, check_ages, unstamped
from cspace.world import POSE_CODES, CheckCancelled, Finding
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
from inference_api.body import body_of
from inference_api.models import Models, ModelStore, Prepared, ServedModel
from inference_api.problems import SAMPLE_PROBLEMS, NoKernelsError, problem_responses
from services.names import model_of
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
        description="`name` (its champion), `name@alias`, `name/version` or `pretrained`.",
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
        return await models.resolve(_reference(request, models.model_name))

    return resolve


def _reference(request: SceneFields, default: str) -> ModelReference:
    if request.model is None and request.robot is not None and not is_digest(request.robot):
        return ModelReference.parse(model_of(request.robot))
    return ModelReference.parse(default if request.model is None else request.model)


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


def prepare(
    models: ModelStore,
    bundle: Bundle,
    view: View,
    check_cancelled: CheckCancelled,
    check_pose: bool = False,
) -> Prepared:
    """Pictures decoded and encoded for a bundle, from memory where they were before.

    With ``check_pose`` a pose or state by which the arm is clearly elsewhere is refused.

    Raises:
        ImageError: a picture or a camera is none that is accepted.
        InputError: what is known does not fit.
    """

    def make() -> Prepared:
        began = time.perf_counter()
        examined = bundle.spec.world.examine_picture(view, check_cancelled)
        decoded = time.perf_counter()
        check_cancelled()
        picture = bundle.prepare(examined)
        encoded = time.perf_counter()
        return Prepared(
            picture,
            decode_ms=1e3 * (decoded - began),
            encode_ms=1e3 * (encoded - decoded),
            findings=examined.findings,
            without_state=examined.without_state,
        )

    prepared = models.prepared(bundle, view.digest(), make)
    wrong = [one for one in prepared.findings if one.code in POSE_CODES]
    if check_pose and wrong:
        raise ImageError(
            f"the arm is not where `state` and the camera's pose put it: {wrong[0].code}",
            expected="the arm in the picture where `state` and `pose` say",
            got=wrong[0].seen,
            remedy=f"{wrong[0].remedy}; POST /doctor looks closer; check_pose false answers all the same",
        )
    return prepared


@contextmanager
def needs_kernels() -> Iterator[None]:
    """Answers 501 where a search needs the compiler of the checks, and it is not installed."""
    try:
        yield
    except ImportError as error:
        raise NoKernelsError(
            "this server does not plan",
            expected="the packages of the extra plan",
            got=f"no {error.name or 'compiler'}",
            remedy="ask a server that has them, or sample here and plan elsewhere",
        ) from error


def about(served: ServedModel, novelty: float | None, warnings: list[PictureWarning]) -> dict[str, Any]:
    """What every answer about pictures says of them and of the model."""
    return {
        "scenario": ScenarioInfo(novelty=novelty),
        "warnings": warnings,
        "joint_space": JointSpaceInfo(**served.bundle.spec.joint_space),
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
        "X-Joint-Space": json.dumps(served.bundle.spec.joint_space, separators=(",", ":")),
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
    return {200: success, **problem_responses(*SAMPLE_PROBLEMS)}


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
