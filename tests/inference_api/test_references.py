"""How requests name models."""

import pytest

from cspace.errors import InputError
from inference_api.references import ModelReference


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cspace-sampler", ModelReference("cspace-sampler")),
        ("a.b_c-d@blue-green", ModelReference("a.b_c-d", alias="blue-green")),
        ("m/12", ModelReference("m", version=12)),
    ],
)
def test_references_are_read_and_written(text: str, expected: ModelReference) -> None:
    assert ModelReference.parse(text) == expected
    assert str(expected) == text


@pytest.mark.parametrize(
    "text", ["", ".", "..", "a/", "a@", "/1", "a/01", "a/1/2", "a b", "a\n", ".hidden", "ä"]
)
def test_what_is_no_reference_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="name@alias"):
        ModelReference.parse(text)
