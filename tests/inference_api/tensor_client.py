"""Bodies of the Open Inference Protocol from the client's side, written apart from the server's code."""

import base64
import json
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

from cspace.png import encode_png
from tests.bundles import picture
from tests.inference_api.client import ApiClient

LENGTH = "Inference-Header-Content-Length"
INFER = "/v2/models/{}/infer"
IMAGES = np.stack([picture(seed) for seed in range(3)])
NUMPY = {"UINT8": "u1", "INT32": "<i4", "UINT64": "<u8", "FP32": "<f4"}


def json_input(images: NDArray[np.uint8]) -> dict[str, Any]:
    """Pictures as an input with JSON numbers."""
    return {
        "name": "image",
        "datatype": "UINT8",
        "shape": list(images.shape),
        "data": images.ravel().tolist(),
    }


def binary_input(images: NDArray[np.uint8]) -> dict[str, Any]:
    """Pictures as an input whose bytes follow the JSON object."""
    parameters = {"binary_data_size": images.nbytes}
    return {"name": "image", "datatype": "UINT8", "shape": list(images.shape), "parameters": parameters}


def binary_request(images: NDArray[np.uint8], **members: Any) -> dict[str, Any]:
    """Arguments of a POST with pictures as bytes."""
    head = json.dumps({"inputs": [binary_input(images)], **members}).encode()
    return {"content": head + images.tobytes(), "headers": {LENGTH: str(len(head))}}


def outputs_of(answer: httpx.Response) -> dict[str, NDArray[Any]]:
    """The arrays of an answer by name."""
    assert answer.status_code == 200, answer.text
    length = int(answer.headers.get(LENGTH, len(answer.content)))
    head, tail = json.loads(answer.content[:length]), answer.content[length:]
    arrays: dict[str, NDArray[Any]] = {}
    for output in head["outputs"]:
        dtype, shape = NUMPY[output["datatype"]], output["shape"]
        if "data" in output:
            arrays[output["name"]] = np.array(output["data"], dtype=dtype).reshape(shape)
        else:
            size = output["parameters"]["binary_data_size"]
            arrays[output["name"]] = np.frombuffer(tail[:size], dtype=dtype).reshape(shape)
            tail = tail[size:]
    assert tail == b""
    return arrays


def infer(api: ApiClient, model: str, **options: Any) -> httpx.Response:
    """The answer to a request for inference."""
    return api.post(INFER.format(model), **options)


def sampled(api: ApiClient, image: NDArray[np.uint8], **fields: Any) -> dict[str, Any]:
    """The other page's answer to the same question."""
    body = {"image": base64.b64encode(encode_png(image)).decode(), **fields}
    answer = api.post("/sample", json=body)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found
