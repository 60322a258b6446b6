"""``POST /outcomes``: what became of earlier answers, kept until it is uploaded."""

import time
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Request
from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.errors import InputError
from cspace_client.wire import OutcomesAnswer, OutcomesRequest
from inference_api.problems import NO_OUTCOMES, RequestError
from inference_api.request_body import JSON, body_of
from inference_api.scene import REQUEST_ID_HEADER
from inference_api.served_models import ServedModel
from services.outcomes import Spool, matched, view_row


async def _spool(request: Request) -> Spool:
    spool: Spool | None = request.app.state.spool
    if spool is None:
        raise RequestError(
            NO_OUTCOMES,
            "this server keeps no outcomes",
            remedy="set CSPACE_OUTCOMES to a folder where the server runs",
        )
    return spool


router = APIRouter()
_SCHEMA = {"$ref": "#/components/schemas/OutcomesRequest"}


@router.post(
    "/outcomes",
    status_code=202,
    summary="Report what became of earlier answers",
    openapi_extra={"requestBody": {"required": True, "content": {JSON: {"schema": _SCHEMA}}}},
    responses={
        202: {
            "description": "They are on disk.",
            "model": OutcomesAnswer,
            "headers": REQUEST_ID_HEADER,
        },
    },
)
def outcomes(
    spool: Annotated[Spool, Depends(_spool)],
    request: Annotated[OutcomesRequest, Depends(body_of(OutcomesRequest, JSON))],
    http: Request,
) -> Response:
    """Keeps the outcomes in a bounded folder of the server. An outcome that is sent twice counts once."""
    reports = [one.model_dump(exclude_none=True) for one in request.outcomes]
    rows = matched(reports, http.app.state.receipts, key_name(http))
    if not rows:
        raise InputError(
            "outcomes match no answer",
            expected="receipt, as the answer of POST /plan to the same client has it",
            got="none of this server",
        )
    body = OutcomesAnswer(kept=len(rows) if spool.add(rows) else 0)
    return Response(body.model_dump_json(), 202, media_type=JSON)


def keep_plan(request: Request, served: ServedModel, view: bytes, path: NDArray[np.float64]) -> bool:
    """Whether a plan's pictures and path are taken for the upload of outcomes, to train on."""
    spool: Spool | None = request.app.state.spool
    keep_s = 86_400.0 * request.app.state.settings.outcomes_keep_days
    if spool is None or not keep_s:
        return False
    asked = {"request_id": request.state.request_id, **_received(request)}
    return spool.add([asked | view_row(served, served.bundle.robot, view, path, keep_s)])


def key_name(request: Request) -> str | None:
    """The name of the key that a request came with."""
    name: str | None = getattr(request.state, "client", None)
    return name


def _received(request: Request) -> dict[str, Any]:
    return {"client": key_name(request), "received_s": round(time.time(), 3)}
