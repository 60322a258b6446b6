"""How requests name models."""

import pytest

from cspace.errors import ConfigError, InputError
from inference_api.models.references import ModelReference, served_name


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


@pytest.mark.parametrize("name", ["../m", "m/1", "m@champion", ".m", "", "a" * 101, "pretrained", "m\n"])
def test_a_default_that_no_request_could_name_is_a_wrong_setting(name: str) -> None:
    with pytest.raises(ConfigError, match="CSPACE_MODEL_NAME"):
        served_name(name)


def test_a_default_that_requests_can_name_is_taken() -> None:
    assert served_name("a.b_c-d") == "a.b_c-d"
