"""JSON, YAML and .npy files of strangers become plain values or the project's errors."""

import io

import numpy as np
import pytest

from cspace.errors import ConfigError
from cspace.files import MAX_YAML_BYTES, parse_json, read_npy, read_yaml


@pytest.mark.parametrize(
    ("text", "values"),
    [("a: 1e-3", {"a": 0.001}), ("[1, null, yes]", [1, None, True]), ("", None), ("&a [1]", [1])],
)
def test_yaml_becomes_plain_values(text, values):
    assert read_yaml(text, "the text", ConfigError) == values


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        "- " * 1000,
        "&a [*a]",
        "[&a [1]" + ", *a" * 21 + "]",
        "!!python/object:os.system x",
        "{[1]: 2}",
        "\0",
        b"\xff",
        "a: 2020-13-45",
        "a" * (MAX_YAML_BYTES + 1),
    ],
)
def test_other_texts_are_no_yaml(text):
    with pytest.raises(ConfigError, match="the text"):
        read_yaml(text, "the text", ConfigError)


@pytest.mark.parametrize("data", [b"", b"[1", b"NaN", b'"\xff"', b"[" * 100_000])
def test_other_bytes_are_no_json(data):
    with pytest.raises(ValueError, match="line 1"):
        parse_json(data)


def npy(array, **options):
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_is_read_as_it_was_written(order):
    array = np.asarray(np.arange(6.0, dtype="<f4").reshape(2, 3), order=order)
    np.testing.assert_array_equal(read_npy(npy(array), ("<f4",), 2), array)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        npy(np.zeros((2, 3), "<f4"))[:-1],
        npy(np.zeros((2, 3), "<f8")),
        npy(np.zeros(3, "<f4")),
        npy(np.array([[{}]], dtype=object), allow_pickle=True),
        npy(np.zeros((2, 3), "<f4")).replace(b"(2, 3)", b"(9, 9)"),
    ],
)
def test_other_arrays_are_refused(data):
    with pytest.raises(ValueError, match=r"."):
        read_npy(data, ("<f4",), 2)
