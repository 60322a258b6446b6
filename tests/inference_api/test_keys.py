"""API keys: made, written down, read, compared; and who may start a server without them."""

import hashlib
import os
from pathlib import Path

import pytest
from fastapi import FastAPI

from cspace.errors import ConfigError
from inference_api.keys import ApiKeys, bearer_token, check_exposure, is_loopback, main
from inference_api.limits import add_limits
from inference_api.settings import Protection


def make(capsys: pytest.CaptureFixture[str], name: str) -> tuple[str, str]:
    """A key and its line, from the command's output."""
    assert main([name]) == 0
    shown, line = capsys.readouterr().out.splitlines()
    return shown.rpartition(" ")[2], line


def test_a_made_key_is_known_by_the_line_that_is_printed_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = {name: make(capsys, name) for name in ("robot-1", "lab")}
    path = tmp_path / "keys"
    path.write_text("# two\n\n" + "\n".join(line for _, line in keys.values()) + "\n")
    known = ApiKeys.read(path)
    assert keys["robot-1"][0] != keys["lab"][0]
    for name, (key, line) in keys.items():
        # 32 bytes are 43 characters of base64.
        assert len(key) == len("csk_") + 43
        assert line == f"{name}:{hashlib.sha256(key.encode()).hexdigest()}"
        assert known.name_of(key) == name
        assert known.name_of(key[:-1]) is None
        assert known.name_of(line.partition(":")[2]) is None
        assert key not in path.read_text()
    assert known.name_of("") is None
    assert known.name_of("\udcff") is None


DIGEST = "ab" * 32


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
        f"lab:{DIGEST}\nlab:{DIGEST}",
    ],
)
def test_a_wrong_file_is_an_error_that_names_the_remedy_and_no_secret(tmp_path: Path, text: str) -> None:
    path = tmp_path / "keys"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"inference_api\.keys NAME") as caught:
        ApiKeys.read(path)
    assert DIGEST[:-1] not in str(caught.value)


def test_a_file_that_is_not_there_no_text_or_far_too_large_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "bytes").write_bytes(b"\xff\xfe")
    (tmp_path / "large").touch(0o600)
    os.truncate(tmp_path / "large", 2**40)
    for name, words in (
        ("nothing", "CSPACE_API_KEYS_FILE"),
        ("bytes", "CSPACE_API_KEYS_FILE"),
        ("large", "too large"),
    ):
        with pytest.raises(ConfigError, match=words):
            ApiKeys.read(tmp_path / name)


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_is_an_error(tmp_path: Path, mode: int) -> None:
    path = tmp_path / "keys"
    path.write_text(f"lab:{DIGEST}\n")
    path.chmod(mode)
    with pytest.raises(ConfigError, match="chmod go-w"):
        ApiKeys.read(path)
    path.chmod(0o444)
    assert ApiKeys.read(path).name_of("csk_unknown") is None


@pytest.mark.parametrize(("mode", "lines"), [(0o600, 0), (0o640, 0), (0o444, 1), (0o644, 1)])
def test_a_file_that_everybody_may_read_leaves_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, mode: int, lines: int
) -> None:
    path = tmp_path / "keys"
    path.write_text(f"lab:{DIGEST}\n")
    path.chmod(mode)
    add_limits(FastAPI(), Protection(keys_file=path))
    assert len(caplog.messages) == lines
    assert DIGEST not in caplog.text


def test_a_wrong_name_makes_no_key(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["a:b"])
    assert caught.value.code == 2
    assert "csk_" not in capsys.readouterr().out


def test_the_token_is_read_from_one_bearer_header() -> None:
    for header, token in (
        ("Bearer abc", "abc"),
        ("bearer  abc ", "abc"),
        ("Bearer", None),
        ("Basic abc", None),
    ):
        assert bearer_token([header]) == token
    for headers in ([], ["Bearer "], ["Bearer abc", "Bearer abc"]):
        assert bearer_token(headers) is None


def test_loopback_needs_no_keys_and_other_addresses_need_keys_or_a_word(tmp_path: Path) -> None:
    for host in ("127.0.0.1", "127.1.2.3", "::1", "localhost"):
        assert is_loopback(host)
        check_exposure(host, None, allowed=False)
    path = tmp_path / "keys"
    path.write_text(f"lab:{DIGEST}\n")
    for host in ("0.0.0.0", "::", "", "192.0.2.1", "server.example"):  # noqa: S104
        with pytest.raises(ConfigError, match="--allow-unauthenticated"):
            check_exposure(host, None, allowed=False)
        check_exposure(host, None, allowed=True)
        check_exposure(host, path, allowed=False)
    # A word does not excuse a wrong file of keys.
    with pytest.raises(ConfigError):
        check_exposure("127.0.0.1", tmp_path / "nothing", allowed=True)
