"""Which models can be asked: the list, models that are not ready, and those that come with the server."""

from pathlib import Path

import pytest

from cspace.worlds.planar.arm import THREE_LINK
from inference_api.settings import ApiSettings
from tests.bundles import write_tiny_bundle
from tests.inference_api.answers import PNG, assert_answers, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.raw import until
from tests.inference_api.test_robots import THREE, TWO, ask
from tests.inference_api.test_telemetry import increase, labelled, scrape, value

THREE_NAME = "pretrained-panda"


def references(api: ApiClient, query: str = "") -> list[str]:
    return [item["reference"] for item in api.get(f"/models{query}").json()["models"]]


def test_the_list_of_models_names_all_that_a_request_can(own_api: ApiClient) -> None:
    body = own_api.get("/models").json()
    assert (body["default"], body["registry"]) == ("cspace-sampler", "reachable")
    assert [(item["reference"], item["loaded"], item["default"]) for item in body["models"]] == [
        ("cspace-sampler/5", False, False),
        ("cspace-sampler/4", False, False),
        ("cspace-sampler/3", False, False),
        ("cspace-sampler/2", False, False),
        ("cspace-sampler/1", True, True),
        ("pretrained", True, False),
    ]
    assert {item["version"]: item["aliases"] for item in body["models"]}[2] == ["challenger"]


def test_models_of_other_robots_are_listed_where_an_alias_names_them(
    own_api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], name="arm-sampler")
    registry.add(bundles["other"], "champion", name="arm-sampler")
    registry.add(bundles["plain"], name="another-sampler")
    # It answers no request.
    registry.add(bundles["plain"], "champion", name="scene-model")
    assert references(own_api)[5:] == ["arm-sampler/2", "pretrained"]
    assert references(own_api, "?name=arm-sampler") == ["arm-sampler/2", "arm-sampler/1", "pretrained"]
    assert_problem(own_api.get("/models", params={"name": "../x"}), 422, "invalid-value")


def test_no_model_at_all_is_503_and_not_ready_but_alive(
    start_api: StartApi, registry: CountingRegistry
) -> None:
    api = start_api(registry, shipped=False)
    before = scrape(api)
    answer = api.post("/sample", files={"image": PNG})
    assert "promote" in assert_problem(answer, 503, "no-model")["remedy"]
    assert_problem(api.post("/sample", files={"image": PNG}, data={"model": "pretrained"}), 503, "no-model")
    assert_problem(api.get("/health/ready"), 503, "no-model")
    assert api.get("/health/live").json() == {"status": "live"}
    found = increase(before, scrape(api))
    assert value(found, "cspace_failures_total", reason="no-model") == 3
    assert not labelled(scrape(api), "cspace_model_info", "name")


def test_a_version_that_fails_its_checks_is_503_and_the_champion_goes_on(
    own_api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    number = registry.add(bundles["other"], digest="0" * 64)
    answer = own_api.post("/sample", files={"image": PNG}, data={"model": f"cspace-sampler/{number}"})
    problem = assert_problem(answer, 503, "no-model")
    assert "refused" in problem["detail"]
    assert own_api.post("/sample", files={"image": PNG}).json()["model"]["version"] == 1


def test_a_registry_that_is_away_is_503_for_versions_that_are_not_here(
    own_api: ApiClient, registry: CountingRegistry
) -> None:
    registry.away = True
    answer = own_api.post("/sample", files={"image": PNG}, data={"model": "cspace-sampler/2"})
    assert_problem(answer, 503, "registry-unavailable")
    assert own_api.get("/models").json()["registry"] == "unreachable"
    assert references(own_api) == ["pretrained"]
    assert_answers(own_api)


@pytest.fixture
def folders(tmp_path: Path, bundles: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Bundles of two robots, as if they came with the server."""
    found = {"pretrained": bundles["shipped"], THREE_NAME: write_tiny_bundle(tmp_path / "three", THREE_LINK)}
    monkeypatch.setattr(ApiSettings, "shipped_folders", found)
    return found


def listed(api: ApiClient) -> dict[str, tuple[bool, bool, str]]:
    models = api.get("/models").json()["models"]
    return {one["reference"]: (one["loaded"], one["default"], one["robot"]) for one in models}


@pytest.mark.usefixtures("folders")
def test_the_first_is_loaded_and_the_default_and_others_come_when_asked_for(start_api: StartApi) -> None:
    api = start_api(None)
    assert listed(api) == {"pretrained": (True, True, TWO), THREE_NAME: (False, False, THREE)}
    model = ask(api, model=THREE_NAME).json()["model"]
    assert (model["name"], model["version"], model["robot"]) == (THREE_NAME, 0, THREE)
    assert model["fallback"] is False
    assert listed(api)[THREE_NAME] == (True, False, THREE)


@pytest.mark.usefixtures("folders")
def test_a_name_without_a_registered_model_is_answered_by_what_is_shipped_of_its_robot(
    start_api: StartApi, registry: CountingRegistry, tmp_path: Path
) -> None:
    api = start_api(registry, model_poll_s=0.2)
    model = ask(api, model="three-link-sampler").json()["model"]
    assert (model["name"], model["fallback"]) == (THREE_NAME, True)
    for wrong in ("three-link-sampler/1", "three-link-sampler@champion", "four-link-sampler"):
        assert_problem(ask(api, model=wrong), 404, "unknown-model")
    own = write_tiny_bundle(tmp_path / "own", THREE_LINK, scale=3.0)
    registry.add(own, "champion", name="three-link-sampler")
    # That there was none is remembered for a moment.
    until(lambda: ask(api, model="three-link-sampler").json()["model"]["fallback"] is False)


@pytest.mark.usefixtures("folders")
@pytest.mark.parametrize("has_registry", [False, True])
def test_a_server_of_another_robot_stands_on_its_own_shipped_model(
    start_api: StartApi, registry: CountingRegistry, has_registry: bool
) -> None:
    api = start_api(registry if has_registry else None, model_name="three-link-sampler")
    model = ask(api).json()["model"]
    assert (model["name"], model["robot"], model["fallback"]) == (THREE_NAME, THREE, True)


def test_a_broken_one_is_left_out_and_the_others_answer(
    start_api: StartApi, folders: dict[str, Path]
) -> None:
    (folders[THREE_NAME] / "generator.onnx").write_bytes(b"nothing")
    api = start_api(None)
    assert list(listed(api)) == ["pretrained"]
    assert_problem(ask(api, model=THREE_NAME), 503, "no-model")
    assert ask(api).status_code == 200
