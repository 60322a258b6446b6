"""A real API process whose registry never comes to an end."""

import time
from pathlib import Path

import httpx
import psutil
import pytest

from tests.inference_api.server import server_process
from tests.inference_api.trickling import trickling

pytestmark = [pytest.mark.e2e, pytest.mark.slow]
# Less than the server gives to requests that it is still answering.
END_S = 8.0


def test_it_answers_by_default_and_ends_by_itself_with_all_its_processes(
    tmp_path: Path, png: bytes, bundles: dict[str, Path]
) -> None:
    with trickling() as place:
        settings = {
            "MLFLOW_TRACKING_URI": f"http://user:secret@{place}",
            "CSPACE_PRETRAINED_MODEL": str(bundles["shipped"]),
        }
        with server_process(tmp_path, settings) as server, httpx.Client(base_url=server.address) as client:
            # Each would have taken one of the threads that compute, for ever.
            for _ in range(40):
                began_s = time.monotonic()
                answer = client.post("/sample", files={"image": png}, data={"n": "3"})
                assert (answer.status_code, answer.json()["model"]["fallback"]) == (200, True)
                # A look at the registry is given up after 8 s.
                assert time.monotonic() - began_s < 7.0
            named = client.post(
                "/sample", files={"image": png}, data={"model": "cspace-sampler/7"}, timeout=60
            )
            assert named.status_code == 503
            ready = client.get("/health/ready").json()
            assert (ready["status"], ready["registry"]) == ("ready", "unreachable")
            texts = named.text + server.log.read_text() + client.get("/models", timeout=60).text
            children = psutil.Process(server.process.pid).children(recursive=True)
            server.process.terminate()
            began_s = time.monotonic()
            assert server.process.wait(30) == 0
            assert time.monotonic() - began_s < END_S
        # The tracker of multiprocessing ends behind its server.
        assert psutil.wait_procs(children, timeout=5)[1] == []
    texts += server.log.read_text()
    assert place not in texts
    assert "secret" not in texts
    assert str(tmp_path) not in texts.replace(server.address, "")
