"""Models tell their robot, and answer for no other."""

import base64
import json
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from cspace.worlds import examples, robot_digest
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from inference_api.app import create_app
from inference_api.settings import ApiSettings
from services.names import MODEL_NAME
from tests.bundles import write_tiny_bundle
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient, running
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.tensor_client import IMAGES, json_input

NPY = {"accept": "application/x-npy"}
LIMITED = PlanarArm(joint_limits_rad=((-2.9, 4.0), None))
TWO, THREE, *_ = (robot_digest(world) for world in examples().values())


def ask(api: ApiClient, headers: dict[str, str] | None = None, **fields: str) -> httpx.Response:
    return api.post("/sample", files={"image": PNG}, data={"n": "3", **fields}, headers=headers)


def infer(api: ApiClient, model: str, **parameters: str | int) -> httpx.Response:
    body = {"inputs": [json_input(IMAGES[:1])], "parameters": parameters}
    return api.post(f"/v2/models/{model}/infer", json=body)


def test_every_answer_tells_the_robot(api: ApiClient) -> None:
    assert ask(api).json()["model"]["robot"] == TWO
    assert ask(api, NPY).headers["x-robot"] == TWO
    assert infer(api, MODEL_NAME, n=3).json()["parameters"]["robot"] == TWO
    assert api.get("/health/ready").json()["model"]["robot"] == TWO


def test_the_models_own_robot_is_answered_as_none(api: ApiClient) -> None:
    with_it = ask(api, seed="7", robot=TWO).json()
    assert with_it["samples"] == ask(api, seed="7").json()["samples"]
    assert infer(api, MODEL_NAME, n=3, robot=TWO).status_code == 200


def test_another_robot_is_refused_before_anything_is_computed(api: ApiClient) -> None:
    for model in (MODEL_NAME, f"{MODEL_NAME}@challenger", "pretrained"):
        # Not even the picture is looked at.
        garbage = {"image": base64.b64encode(b"no picture").decode(), "robot": THREE, "model": model}
        problem = assert_problem(api.post("/sample", json=garbage), 409, "other-robot")
        assert THREE in problem["expected"]
        assert problem["got"].startswith(TWO)
        assert str(list(TWO_LINK.link_lengths_m)) in problem["got"]
        refused = infer(api, model, n=3, robot=THREE)
        assert (refused.status_code, THREE in refused.json()["error"]) == (409, True)


def test_an_arm_that_collides_with_itself_is_another_robot(
    start_api: StartApi, registry: CountingRegistry, tmp_path: Path
) -> None:
    folding = replace(THREE_LINK, self_collision=True)
    digest = robot_digest(PlanarWorld(folding))
    registry.add(write_tiny_bundle(tmp_path / "folding", folding), "champion")
    api = start_api(registry)
    assert listed(api)[f"{MODEL_NAME}/1"]["world"]["robot"]["self_collision"] is True
    assert ask(api, NPY).headers["x-robot"] == digest != THREE
    assert ask(api, robot=digest).status_code == 200
    problem = assert_problem(ask(api, robot=THREE), 409, "other-robot")
    assert '"self_collision": true' in problem["got"]


def listed(api: ApiClient) -> dict[str, dict[str, object]]:
    return {item["reference"]: item for item in api.get("/models").json()["models"]}


def test_the_list_tells_robot_limits_and_camera_of_what_is_loaded_and_of_what_is_not(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path], tmp_path: Path
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.add(write_tiny_bundle(tmp_path / "limited", LIMITED))
    models, world = listed(start_api(registry)), PlanarWorld(LIMITED)
    assert [models[f"{MODEL_NAME}/{number}"]["loaded"] for number in (1, 2)] == [True, False]
    entry = models[f"{MODEL_NAME}/2"]
    assert entry["robot"] == robot_digest(world)
    assert entry["world"] == json.loads(json.dumps(world.to_dict()))
    assert entry["joint_space"] == world.space.to_dict()
    assert "self_collision" not in entry["world"]["robot"]
    for reference in (f"{MODEL_NAME}/1", "pretrained"):
        assert models[reference]["robot"] == TWO
        assert models[reference]["world"] == json.loads(json.dumps(PlanarWorld().to_dict()))
        assert models[reference]["joint_space"] == {"kind": "torus", "dim": 2, "unit": "rad"}


STRANGE: list[tuple[dict[str, str], str | None]] = [
    ({}, None),
    ({"robot": TWO}, TWO),
    ({"robot": "<b>", "world": "{"}, None),
    ({"robot": TWO, "world": '{"kind": "planar"}'}, TWO),
    ({"world": "[" * 3000}, None),
    ({"world": "\ud800"}, None),
    ({"world": " " * 5000}, None),
]


def test_a_version_of_an_older_release_or_with_strange_tags_is_listed_without(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    for tags, _ in STRANGE:
        version = registry.version(MODEL_NAME, registry.add(bundles["plain"]))
        registry._versions[MODEL_NAME][-1] = replace(version, tags=tags)
    models = listed(start_api(registry))
    for number, (_, robot) in enumerate(STRANGE, 1):
        entry = models[f"{MODEL_NAME}/{number}"]
        assert (entry["robot"], entry["world"], entry["joint_space"]) == (robot, None, None)


def server(folder: Path, shipped: Path, registry: CountingRegistry | None, name: str) -> ApiSettings:
    return ApiSettings(
        cache_folder=folder / "cache", poll_s=3600.0, pretrained_folder=shipped, model_name=name
    )


@pytest.mark.parametrize("kind", ["no registry", "an empty registry", "away"])
def test_the_shipped_model_of_another_robot_does_not_stand_in(
    tmp_path: Path, bundles: dict[str, Path], registry: CountingRegistry, kind: str
) -> None:
    registry.away = kind == "away"
    settings = server(tmp_path, bundles["shipped"], registry, "three-link-sampler")
    with running(create_app(settings, None if kind == "no registry" else registry)) as api:
        for answer in (ask(api), ask(api, model="three-link-sampler"), api.get("/health/ready")):
            problem = assert_problem(answer, 503, "no-model")
            assert "another robot" in problem["got"] or "no model" in problem["got"]
        assert ask(api, model="pretrained").json()["model"]["robot"] == TWO


def test_a_champion_of_another_robot_that_is_gone_has_no_stand_in_even_after_a_restart(
    tmp_path: Path, bundles: dict[str, Path], registry: CountingRegistry
) -> None:
    registry.add(write_tiny_bundle(tmp_path / "limited", LIMITED), "champion", name="team")
    settings = server(tmp_path, bundles["shipped"], registry, "team")
    with running(create_app(settings, registry)) as api:
        assert ask(api).json()["model"]["robot"] == robot_digest(PlanarWorld(LIMITED))
        registry.drop_alias("champion", name="team")
        api.refresh()
        assert_problem(ask(api), 503, "no-model")
    with running(create_app(settings, registry)) as api:
        assert_problem(ask(api), 503, "no-model")


def test_another_models_versions_are_listed_by_its_name(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path], tmp_path: Path
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.add(write_tiny_bundle(tmp_path / "three", THREE_LINK), name="three-link-sampler")
    api = start_api(registry)
    found = api.get("/models", params={"name": "three-link-sampler"}).json()
    assert [(one["reference"], one["robot"]) for one in found["models"]] == [
        ("three-link-sampler/1", THREE),
        ("pretrained", TWO),
    ]
    assert found["default"] == MODEL_NAME
    assert list(listed(api)) == [f"{MODEL_NAME}/1", "pretrained"]
    assert_problem(api.get("/models", params={"name": "../x"}), 422, "invalid-value")


def test_a_robots_name_stands_for_its_model(panda_api: ApiClient, png: bytes) -> None:
    def ask(**fields: str) -> httpx.Response:
        return panda_api.post("/sample", files={"image": png}, data={"n": "3", **fields})

    named = ask(robot="two-link").json()["model"]
    assert (named["name"], named["robot"]) == ("pretrained", TWO)
    # The arm's model answers, which takes no picture of a plane.
    assert_problem(ask(robot="panda"), 422, "invalid-image")
    assert "nobody-sampler" in assert_problem(ask(robot="nobody"), 404, "unknown-model")["detail"]
    for fields in ({"robot": "two-link", "model": "pretrained"}, {"robot": "-"}):
        problem = assert_problem(ask(**fields), 422, "invalid-value")
        assert "a robot's name" in problem["errors"][0]["expected"]
