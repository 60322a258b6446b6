"""Arrays as the answer to a request of the Open Inference Protocol."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from fastapi.responses import Response
from numpy.typing import NDArray

from cspace.errors import InputError
from cspace.world import Finding
from inference_api.models.served import ServedModel
from inference_api.open_inference.tensor_request import flag
from inference_api.open_inference.tensor_schemas import InferenceRequest, RequestedOutput
from inference_api.open_inference.tensors import JSON_LENGTH, Tensor, write_tensors
from inference_api.pages.schemas import PictureWarning, warnings_of
from inference_api.pages.validation import brief_members

_BINARY = "binary_data"


def answer_of(
    served: ServedModel,
    request: InferenceRequest,
    arrays: Mapping[str, NDArray[Any]],
    *,
    binary: bool,
    findings: Iterable[Finding] = (),
) -> Response:
    """The outputs that were asked for, in their order.

    Args:
        served: the model that answered.
        request: what was asked.
        arrays: every output that there is, by name.
        binary: whether outputs come as bytes unless they are asked for otherwise.
        findings: of the pictures, for the parameter ``warnings``.

    Raises:
        InputError: an output is asked for that is not there, or twice.
    """
    asked = _asked(request.outputs, arrays, binary)
    outputs = [Tensor(name, arrays[name], as_bytes) for name, as_bytes in asked]
    head = _head(served, warnings_of(findings)) | ({} if request.id is None else {"id": request.id})
    written = write_tensors(head, outputs)
    if written.json_length is None:
        return Response(written.content, media_type="application/json")
    headers = {JSON_LENGTH: str(written.json_length)}
    return Response(written.content, headers=headers, media_type="application/octet-stream")


def _asked(
    requested: Sequence[RequestedOutput] | None, arrays: Mapping[str, NDArray[Any]], binary: bool
) -> list[tuple[str, bool]]:
    """Names of the outputs in their order, each with whether it comes as bytes."""
    if not requested:
        return [(name, binary) for name in arrays]
    asked: dict[str, bool] = {}
    for output in requested:
        if output.name not in arrays or output.name in asked or set(output.parameters) - {_BINARY}:
            raise InputError(
                f"the output {output.name} cannot be had",
                expected=f"each of {', '.join(arrays)} at most once, with no other parameter than {_BINARY}",
                got=f"parameters {brief_members(output.parameters)}"[:200],
                remedy="confidence is there for models with a validity head, novelty for those that tell it",
            )
        asked[output.name] = flag(_BINARY, output.parameters.get(_BINARY, binary))
    return list(asked.items())


def _head(served: ServedModel, warnings: Sequence[PictureWarning]) -> dict[str, Any]:
    # Parameters of the protocol are no lists.
    told = {"warnings": json.dumps([one.model_dump() for one in warnings])} if warnings else {}
    return {
        "model_name": served.name,
        "model_version": str(served.version),
        "parameters": {
            "digest": served.bundle.digest,
            "fallback": served.fallback,
            "robot": served.bundle.robot,
            "alias_confirmed": served.confirmed,
            **told,
        },
    }
