"""A real process, real HTTP: what an app in the test's own process cannot show."""

import io
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.worlds.planar.camera import decode_png
from inference_api.limits import MAX_BODY_BYTES
from tests.inference_api.server import ROOT, api_server

pytestmark = pytest.mark.e2e


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[str]:
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundles["plain"])}
    with api_server(tmp_path_factory.mktemp("server"), settings) as found:
        yield found


@pytest.fixture(scope="module")
def picture_file(tmp_path_factory: pytest.TempPathFactory, png: bytes) -> Path:
    path = tmp_path_factory.mktemp("picture") / "scenario.png"
    path.write_bytes(png)
    return path


def assert_answers(address: str, png: bytes) -> None:
    answer = httpx.post(f"{address}/sample", files={"image": png}, data={"n": "3"}, timeout=30)
    assert answer.status_code == 200, answer.text


def curl(*arguments: str) -> bytes:
    tool = shutil.which("curl")
    if tool is None:
        pytest.skip("needs curl")
    command = [tool, "--silent", "--show-error", "--max-time", "60", *arguments]
    return subprocess.run(command, check=True, capture_output=True).stdout


def test_the_same_seed_gives_the_same_bytes_over_http_and_from_the_bundle(
    address: str, picture_file: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    form = ("-F", f"image=@{picture_file}", "-F", "n=500", "-F", "seed=18446744073709551615")
    first, second = (curl(*form, "-H", "Accept: application/x-npy", f"{address}/sample") for _ in range(2))
    assert first == second
    expected = Bundle.load(bundles["plain"]).sample(decode_png(png, 48), 500, 2**64 - 1).samples
    np.testing.assert_array_equal(np.load(io.BytesIO(first)), expected)


def test_simultaneous_requests_give_what_they_give_alone(address: str, png: bytes) -> None:
    def ask(seed: int) -> list[list[float]]:
        data = {"n": "2000", "seed": str(seed)}
        answer = httpx.post(f"{address}/sample", files={"image": png}, data=data, timeout=60)
        samples: list[list[float]] = answer.json()["samples"]
        return samples

    alone = [ask(seed) for seed in range(8)]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(ask, range(8))) == alone


def test_a_body_above_the_limit_is_413_over_http(address: str, png: bytes) -> None:
    def chunks() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65_536 + 2):
            yield bytes(65_536)

    with httpx.Client(timeout=60) as client:
        headers = {"content-type": "application/json"}
        answer = client.post(f"{address}/sample", content=chunks(), headers=headers)
        assert answer.status_code == 413
        assert answer.json()["type"] == "urn:cspace-sampler:problem:body-too-large"
        again = client.post(f"{address}/sample", files={"image": png}, data={"n": "3"})
        assert again.status_code == 200


def test_curl_is_told_413_too(address: str, tmp_path: Path, png: bytes) -> None:
    large = tmp_path / "large.png"
    large.write_bytes(bytes(MAX_BODY_BYTES + 1))
    output = ("-o", str(tmp_path / "answer"), "-w", "%{http_code}")
    status = curl("-F", f"image=@{large}", *output, f"{address}/sample")
    assert status == b"413"
    assert json.loads((tmp_path / "answer").read_text())["status"] == 413
    assert_answers(address, png)


def test_a_taken_port_is_an_error_with_a_remedy(address: str) -> None:
    command = [sys.executable, "-m", "inference_api", "--port", str(urlsplit(address).port)]
    taken = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert taken.returncode == 1
    assert "--port" in taken.stderr


def test_a_wrong_setting_ends_the_start_with_a_message_and_2() -> None:
    command = [sys.executable, "-m", "inference_api", "--port", "0"]
    environment = {"CSPACE_MODEL_POLL_S": "soon", "HOME": "/nonexistent"}
    process = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert process.returncode == 2
    assert "CSPACE_MODEL_POLL_S" in process.stderr
    assert "Traceback" not in process.stderr
