"""API keys: read, compared, asked for; and who may start a server without them."""

import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.__main__ import main
from inference_api.auth import digest_of, read_keys
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import api_over

KEY, DIGEST = "csk_for-this-test", "ab" * 32
BEARER = {"authorization": f"Bearer {KEY}"}
PAGES = {"/models": 200, "/metrics": 200, "/docs": 200, "/openapi.json": 200, "/guide/": 404, "/nothing": 404}


@pytest.fixture(scope="module")
def locked(tmp_path_factory: pytest.TempPathFactory, bundles: dict[str, Path]) -> Iterator[ApiClient]:
    folder = tmp_path_factory.mktemp("locked")
    path = folder / "keys"
    path.touch(0o600)
    path.write_text(f"# two\n\nother:{digest_of('csk_another')}\nrobot:{digest_of(KEY)}\n")
    with api_over(folder, bundles, None, api_keys_file=path) as client:
        yield client


def test_every_page_but_health_needs_a_key(locked: ApiClient) -> None:
    for path, status in PAGES.items():
        answer = locked.get(path)
        assert_problem(answer, 401, "unauthorized")
        assert answer.headers["www-authenticate"] == 'Bearer realm="cspace-sampler"'
        assert locked.get(path, headers=BEARER).status_code == status, path
    for path in ("/health/live", "/health/ready"):
        assert locked.get(path).status_code == 200, path
    for path in (
        "/health/../models",
        "/health/live/../../models",
        "//models",
        "/health/ready/",
        "/Health/live",
    ):
        assert locked.get(f"http://localhost{path}").status_code == 401, path


def test_samples_need_a_key_and_the_body_of_a_stranger_is_not_read(locked: ApiClient) -> None:
    read = []

    async def body() -> AsyncIterator[bytes]:
        read.append(1)
        yield b"{}"

    refused = locked._call(lambda: locked._client.post("/sample", content=body()))
    assert_problem(refused, 401, "unauthorized")
    assert not read
    answer = locked.post("/sample", files={"image": PNG}, data={"n": "3"}, headers=BEARER)
    assert answer.status_code == 200


def test_a_wrong_key_is_401_and_is_not_repeated(locked: ApiClient) -> None:
    for token in ("wrong", KEY + "x", KEY[:-1], digest_of(KEY), "robot", "%00", "é"):
        answer = locked.get("/models", headers={"authorization": f"Bearer {token}".encode()})
        assert_problem(answer, 401, "unauthorized")
        assert 'error="invalid_token"' in answer.headers["www-authenticate"]
        assert token not in answer.json()["detail"]
    for sent in (f"Basic {KEY}", "Bearer", "Bearer ", KEY):
        assert locked.get("/models", headers={"authorization": sent}).status_code == 401
    twice = locked._call(lambda: locked._client.get("/models", headers=[*BEARER.items(), *BEARER.items()]))
    assert twice.status_code == 401
    assert locked.get("/models", headers={"authorization": f"bearer  {KEY} "}).status_code == 200


@pytest.mark.parametrize(
    "text",
    [
        "",
        "# nothing\n",
        "lab",
        f"lab:{DIGEST[:-1]}",
        f"lab:{DIGEST.upper()}",
        f"a b:{DIGEST}",
        f":{DIGEST}",
        "\xff\xfe",
    ],
)
def test_a_wrong_file_is_an_error_that_names_the_remedy_and_no_secret(tmp_path: Path, text: str) -> None:
    path = tmp_path / "keys"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(ConfigError, match="name:sha256") as caught:
        read_keys(path)
    assert DIGEST[:-1] not in str(caught.value)


def test_a_file_that_is_missing_too_large_or_may_be_written_by_others_is_an_error(tmp_path: Path) -> None:
    large, writable = tmp_path / "large", tmp_path / "writable"
    large.touch(0o600)
    os.truncate(large, 2**40)
    writable.write_text(f"lab:{DIGEST}\n")
    writable.chmod(0o620)
    nothing = tmp_path / "nothing"
    for path, words in ((nothing, "CSPACE_API_KEYS_FILE"), (large, "too large"), (writable, "chmod go-w")):
        with pytest.raises(ConfigError, match=words):
            read_keys(path)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "", "192.0.2.1", "server.example"])  # noqa: S104
def test_a_server_for_other_machines_needs_keys_or_a_word(
    host: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["--host", host])
    assert "--allow-unauthenticated" in capsys.readouterr().err
