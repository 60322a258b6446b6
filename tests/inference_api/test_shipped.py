"""Models of several robots that come with the server."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from cspace.worlds.planar.arm import THREE_LINK
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from tests.bundles import write_tiny_bundle
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient, running
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.raw import until
from tests.inference_api.test_robots import THREE, TWO, ask

THREE_NAME = "pretrained-panda"


@pytest.fixture
def folders(tmp_path: Path, bundles: dict[str, Path]) -> dict[str, Path]:
    return {"pretrained": bundles["shipped"], THREE_NAME: write_tiny_bundle(tmp_path / "three", THREE_LINK)}


def settings(folder: Path, folders: dict[str, Path], name: str = "cspace-sampler") -> ApiSettings:
    first, further = folders["pretrained"], {THREE_NAME: folders[THREE_NAME]}
    return ApiSettings(
        cache_folder=folder / "cache",
        model_name=name,
        poll_s=0.2,
        pretrained_folder=first,
        further_folders=further,
    )


@pytest.fixture
def api(tmp_path: Path, folders: dict[str, Path], registry: CountingRegistry) -> Iterator[ApiClient]:
    with running(create_app(settings(tmp_path, folders), registry)) as api:
        yield api


def listed(api: ApiClient) -> dict[str, tuple[bool, bool, str]]:
    models = api.get("/models").json()["models"]
    return {one["reference"]: (one["loaded"], one["default"], one["robot"]) for one in models}


def test_the_first_is_loaded_and_the_default_and_others_come_when_asked_for(api: ApiClient) -> None:
    assert listed(api) == {"pretrained": (True, True, TWO), THREE_NAME: (False, False, THREE)}
    model = ask(api, model=THREE_NAME).json()["model"]
    assert (model["name"], model["version"], model["robot"], model["fallback"]) == (
        THREE_NAME,
        0,
        THREE,
        False,
    )
    assert listed(api)[THREE_NAME] == (True, False, THREE)


def test_a_name_without_a_registered_model_is_answered_by_what_is_shipped_of_its_robot(
    api: ApiClient, registry: CountingRegistry, tmp_path: Path
) -> None:
    model = ask(api, model="three-link-sampler").json()["model"]
    assert (model["name"], model["fallback"]) == (THREE_NAME, True)
    for wrong in (
        "three-link-sampler/1",
        "three-link-sampler@champion",
        "four-link-sampler",
        f"{THREE_NAME}/1",
    ):
        assert_problem(ask(api, model=wrong), 404, "unknown-model")
    registry.add(
        write_tiny_bundle(tmp_path / "own", THREE_LINK, scale=3.0), "champion", name="three-link-sampler"
    )
    # That there was none is remembered for a moment.
    until(lambda: ask(api, model="three-link-sampler").json()["model"]["fallback"] is False)
    model = ask(api, model="three-link-sampler").json()["model"]
    assert (model["name"], model["version"]) == ("three-link-sampler", 1)


@pytest.mark.parametrize("has_registry", [False, True])
def test_a_server_of_another_robot_stands_on_its_own_shipped_model(
    tmp_path: Path, folders: dict[str, Path], registry: CountingRegistry, has_registry: bool
) -> None:
    own = settings(tmp_path, folders, "three-link-sampler")
    with running(create_app(own, registry if has_registry else None)) as api:
        model = ask(api).json()["model"]
        assert (model["name"], model["robot"], model["fallback"]) == (THREE_NAME, THREE, True)
        assert listed(api)[THREE_NAME] == (True, True, THREE)


def test_a_broken_one_is_left_out_and_the_others_answer(
    tmp_path: Path, folders: dict[str, Path], registry: CountingRegistry
) -> None:
    (folders[THREE_NAME] / "generator.onnx").write_bytes(b"nothing")
    with running(create_app(settings(tmp_path, folders), registry)) as api:
        assert list(listed(api)) == ["pretrained"]
        assert_problem(ask(api, model=THREE_NAME), 503, "no-model")
        assert ask(api).status_code == 200
