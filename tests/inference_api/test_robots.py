"""Models tell their robot and its limits, answer for no other, and ship for several robots."""

import base64
import json
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest

from cspace.worlds import examples, robot_digest
from cspace.worlds.planar.arm import TWO_LINK, PlanarArm
from cspace.worlds.planar.world import PlanarWorld
from services.names import MODEL_NAME
from tests.bundles import holds, write_tiny_bundle
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry

NPY = {"accept": "application/x-npy"}
LIMITED = PlanarArm(joint_limits_rad=((-2.9, 4.0), None))
TWO, THREE, *_ = (robot_digest(world) for world in examples().values())


def ask(api: ApiClient, headers: dict[str, str] | None = None, **fields: str) -> httpx.Response:
    return api.post("/sample", files={"image": PNG}, data={"n": "3", **fields}, headers=headers)


def listed(api: ApiClient) -> dict[str, dict[str, object]]:
    return {item["reference"]: item for item in api.get("/models").json()["models"]}


def test_every_answer_tells_the_robot_which_may_be_named(api: ApiClient) -> None:
    assert ask(api, NPY).headers["x-robot"] == TWO
    assert api.get("/health/ready").json()["model"]["robot"] == TWO
    with_it = ask(api, seed="7", robot=TWO).json()
    assert with_it["model"]["robot"] == TWO
    assert with_it["samples"] == ask(api, seed="7").json()["samples"]


def test_another_robot_is_refused_before_anything_is_computed(api: ApiClient) -> None:
    for model in (MODEL_NAME, f"{MODEL_NAME}@challenger", "pretrained"):
        # Not even the picture is looked at.
        garbage = {"image": base64.b64encode(b"no picture").decode(), "robot": THREE, "model": model}
        problem = assert_problem(api.post("/sample", json=garbage), 409, "other-robot")
        assert THREE in problem["expected"]
        assert problem["got"].startswith(TWO)
        assert str(list(TWO_LINK.link_lengths_m)) in problem["got"]


def test_a_robots_name_stands_for_its_model(panda_api: ApiClient) -> None:
    named = ask(panda_api, robot="two-link").json()["model"]
    assert (named["name"], named["robot"]) == ("pretrained", TWO)
    # The arm's model answers, which takes no picture of a plane.
    assert_problem(ask(panda_api, robot="panda"), 422, "invalid-image")
    assert "nobody-sampler" in assert_problem(ask(panda_api, robot="nobody"), 404, "unknown-model")["detail"]
    assert_problem(ask(panda_api, robot="two-link", model="pretrained"), 422, "invalid-value")


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
    for reference in (f"{MODEL_NAME}/1", "pretrained"):
        assert models[reference]["robot"] == TWO
        assert models[reference]["joint_space"] == {"kind": "torus", "dim": 2, "unit": "rad"}


STRANGE: list[tuple[dict[str, str], str | None]] = [
    ({}, None),
    ({"robot": "<b>", "world": "{"}, None),
    ({"robot": TWO, "world": '{"kind": "planar"}'}, TWO),
    ({"world": "[" * 3000}, None),
    ({"world": "\ud800"}, None),
    ({"world": " " * 5000}, None),
]


def test_a_version_with_strange_tags_is_listed_without_them(
    start_api: StartApi, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    for tags, _ in STRANGE:
        version = registry.version(MODEL_NAME, registry.add(bundles["plain"]))
        registry._versions[MODEL_NAME][-1] = replace(version, tags=tags)
    models = listed(start_api(registry))
    for number, (_, robot) in enumerate(STRANGE, 1):
        entry = models[f"{MODEL_NAME}/{number}"]
        assert (entry["robot"], entry["world"], entry["joint_space"]) == (robot, None, None)


@pytest.mark.parametrize("kind", ["no registry", "an empty registry", "away"])
def test_the_shipped_model_of_another_robot_does_not_stand_in(
    start_api: StartApi, registry: CountingRegistry, kind: str
) -> None:
    registry.away = kind == "away"
    api = start_api(None if kind == "no registry" else registry, model_name="three-link-sampler")
    for answer in (ask(api), ask(api, model="three-link-sampler"), api.get("/health/ready")):
        assert_problem(answer, 503, "no-model")
    assert ask(api, model="pretrained").json()["model"]["robot"] == TWO


def test_a_champion_of_another_robot_that_is_gone_has_no_stand_in_even_after_a_restart(
    start_api: StartApi, registry: CountingRegistry, tmp_path: Path
) -> None:
    registry.add(write_tiny_bundle(tmp_path / "limited", LIMITED), "champion", name="team")
    api = start_api(registry, model_name="team")
    assert ask(api).json()["model"]["robot"] == robot_digest(PlanarWorld(LIMITED))
    registry.drop_alias("champion", name="team")
    api.refresh()
    assert_problem(ask(api), 503, "no-model")
    assert_problem(ask(start_api(registry, model_name="team")), 503, "no-model")


def test_answers_tell_limits_and_keep_them(start_api: StartApi, tmp_path: Path) -> None:
    shipped = write_tiny_bundle(tmp_path / "limited", LIMITED, kind="path", scale=4.0)
    api = start_api(None, pretrained_model=shipped)
    fields = {"n": "2000", "seed": "1", "start": "[3.9, 7.0]", "goal": "[-2.0, 0.0]"}
    body = ask(api, **fields).json()
    assert body["joint_space"] == {
        "kind": "mixed", "dim": 2, "unit": "rad",
        "lower": [-2.9, -np.pi], "upper": [4.0, np.pi], "periodic": [False, True],
    }  # fmt: skip
    assert json.loads(ask(api, NPY, **fields).headers["x-joint-space"]) == body["joint_space"]
    samples = np.float32(body["samples"])
    assert holds(LIMITED.space, samples)
    assert (samples[:, 0] > np.pi).any()
    problem = assert_problem(ask(api, **fields | {"goal": "[4.1, 0.0]"}), 422, "invalid-value")
    assert "goal lies outside the limits" in problem["detail"]
    assert ("4.1" in problem["got"], "-2.9" in problem["expected"]) == (True, True)
