"""How people and requests name models."""

from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.errors import ConfigError, InputError
from services.registry.entities import ModelReference
from tests.bundles import write_tiny_bundle
from tests.fakes.registry import FakeRegistry


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cspace-sampler", ModelReference("cspace-sampler")),
        ("a.b_c-d@blue-green", ModelReference("a.b_c-d", alias="blue-green")),
        ("m/12", ModelReference("m", version=12)),
        ("cspace-sampler@challenger", ModelReference("cspace-sampler", "challenger")),
        ("cspace-sampler/12", ModelReference("cspace-sampler", version=12)),
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


@pytest.mark.parametrize("text", ["", "cspace-sampler", "a/0", "a/x", "a@", "@b", "a@b/1", "../a/1", "a/1\n"])
def test_what_names_no_version_is_refused_where_one_is_needed(text: str) -> None:
    with pytest.raises(ConfigError, match="the model is odd; expected name@alias or name/version"):
        ModelReference.parse_version(text, "the model is odd")


def test_a_reference_is_looked_up_by_its_version_its_alias_or_as_the_champion(tmp_path: Path) -> None:
    registry = FakeRegistry(tmp_path / "registry")
    folder = write_tiny_bundle(tmp_path / "bundle")
    digest = Bundle.load(folder).digest
    for number, alias in ((1, "champion"), (2, "challenger")):
        registry.register("m", folder, f"run{number}", digest, {}, alias=alias)
    found = [str(registry.look_up(ModelReference.parse(text))) for text in ("m", "m@challenger", "m/1")]
    assert found == ["m/1", "m/2", "m/1"]
