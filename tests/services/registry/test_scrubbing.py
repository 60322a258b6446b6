"""What others write is told on without secrets, and to clients without addresses and paths."""

import errno

import pytest
import requests
from mlflow.exceptions import MlflowException

from cspace.errors import RegistryUnavailableError, StorageError
from services.registry.errors import (
    MAX_LENGTH,
    anonymous,
    mapped,
    without_user_info,
)
from services.registry.models import ModelRegistry


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("to http://user:secret@host:5000/api failed", "to http://host:5000/api failed"),
        ("http://user:p@ss/w@host/x", "http://host/x"),
        ("postgresql+psycopg2://u:s@db/mlflow", "postgresql+psycopg2://db/mlflow"),
        ("http://token@host and a@b", "http://host and a@b"),
        ("nothing to hide: m@champion, m/1", "nothing to hide: m@champion, m/1"),
    ],
)
def test_user_and_password_go_and_the_rest_stays(text: str, expected: str) -> None:
    assert without_user_info(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "HTTPConnectionPool(host='host.example', port=5000): Max retries",
        "s3://bucket-secret/host.example/1",
        "127.0.0.1:5000 refused",
        "10.0.0.7",
        "[::1]:5000",
        "host.example:5000 is away",
        "No such file: '/srv/secret/models/m'",
        'at "/srv/secret"',
        "~/secret",
    ],
)
def test_addresses_hosts_and_paths_go(text: str) -> None:
    scrubbed = anonymous(text)
    assert not [
        word for word in ("secret", "host.example", "127.0", "10.0.0", "::1", "srv") if word in scrubbed
    ]


def test_a_line_stays_a_line_of_bounded_length() -> None:
    assert anonymous("a\r\nWARNING forged\x1b[31m\u2028b") == "a WARNING forged [31m b"
    assert len(anonymous("é" * 10_000)) <= MAX_LENGTH + 4


def test_a_full_disk_is_found_however_deep_it_is_wrapped() -> None:
    full = OSError(errno.ENOSPC, "words")
    wrapped = requests.exceptions.ChunkedEncodingError("words")
    wrapped.__context__ = MlflowException("words")
    wrapped.__context__.__cause__ = full
    in_words = MlflowException(f"failures occurred:\n##### File x #####\n{full}")
    for error in (full, wrapped, in_words):
        with pytest.raises(StorageError), mapped("downloading m/1"):
            raise error


def test_errors_of_the_adapter_name_the_host_and_not_the_password() -> None:
    with pytest.raises(RegistryUnavailableError, match=r"127\.0\.0\.1") as caught:
        ModelRegistry("http://user:secret@127.0.0.1:9").version("m", 1)
    assert "secret" not in str(caught.value)
