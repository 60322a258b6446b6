"""NVIDIA's client of the Open Inference Protocol against a real server."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import tritonclient.http as tritonclient

from cspace.png import encode_png
from tests.bundles import picture
from tests.inference_api.server import api_server

pytestmark = [
    pytest.mark.e2e,
    # The client closes its sockets when it is collected.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
IMAGES = np.stack([picture(0), picture(1)])


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["scored"])}
    with api_server(tmp_path_factory.mktemp("triton"), settings) as found:
        yield found


@pytest.fixture(scope="module")
def client(address: str) -> Iterator[Any]:
    found = tritonclient.InferenceServerClient(address.removeprefix("http://"))
    yield found
    found.close()


def image_input(images: np.ndarray, *, binary: bool = True) -> Any:
    tensor = tritonclient.InferInput("image", list(images.shape), "UINT8")
    tensor.set_data_from_numpy(images, binary_data=binary)
    return tensor


def sampled(address: str, image: np.ndarray, **fields: Any) -> dict[str, Any]:
    answer = httpx.post(f"{address}/sample", files={"image": encode_png(image)}, data=fields, timeout=60)
    found: dict[str, Any] = answer.raise_for_status().json()
    return found


def test_the_client_finds_the_server_and_its_model(client: Any) -> None:
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.is_model_ready("pretrained")
    assert client.is_model_ready("pretrained", "0")
    assert not client.is_model_ready("nobody")
    assert client.get_server_metadata()["extensions"] == ["binary_tensor_data"]
    described = client.get_model_metadata("pretrained")
    assert described["inputs"] == [
        {"name": "image", "datatype": "UINT8", "shape": [-1, 48, 48, 3]},
        {"name": "configurations", "datatype": "FP32", "shape": [-1, 2]},
    ]


@pytest.mark.parametrize("binary", [True, False], ids=["bytes", "json"])
def test_the_client_gets_the_samples_of_the_other_page_bit_for_bit(
    client: Any, address: str, binary: bool
) -> None:
    fields = {"n": 500, "seed": 7, "min_confidence": 0.3}
    names = ("samples", "confidence", "seed", "shortfall")
    outputs = [tritonclient.InferRequestedOutput(name, binary_data=binary) for name in names]
    inputs = [image_input(IMAGES[:1], binary=binary)]
    found = client.infer("pretrained", inputs, outputs=outputs, parameters=fields, request_id="42")
    expected = sampled(address, IMAGES[0], **fields)
    assert found.as_numpy("samples").dtype == np.float32
    assert found.as_numpy("samples").tobytes() == np.array(expected["samples"], np.float32).tobytes()
    assert found.as_numpy("confidence").tobytes() == np.array(expected["confidence"], np.float32).tobytes()
    assert found.as_numpy("seed").tolist() == [7]
    assert found.as_numpy("shortfall").tolist() == [expected["shortfall"]]
    response = found.get_response()
    assert (response["id"], response["model_name"], response["model_version"]) == ("42", "pretrained", "0")


def test_the_client_is_told_what_is_wrong(client: Any) -> None:
    for model, fields, status, word in (
        ("nobody", {}, "404", "unknown"),
        ("pretrained", {"n": 0}, "400", "from 1 to 20000"),
    ):
        with pytest.raises(tritonclient.InferenceServerException, match=word) as caught:
            client.infer(model, [image_input(IMAGES[:1])], parameters=fields)
        assert caught.value.status() == status
