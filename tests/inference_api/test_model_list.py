from pathlib import Path

from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry


def test_the_list_of_models_names_all_that_a_request_can(own_api: ApiClient) -> None:
    body = own_api.get("/models").json()
    assert (body["default"], body["registry"]) == ("cspace-sampler", "reachable")
    assert [item["reference"] for item in body["models"]] == [
        "cspace-sampler/5",
        "cspace-sampler/4",
        "cspace-sampler/3",
        "cspace-sampler/2",
        "cspace-sampler/1",
        "pretrained",
    ]
    assert [item["reference"] for item in body["models"] if item["default"]] == ["cspace-sampler/1"]
    assert {item["version"]: item["aliases"] for item in body["models"]}[2] == ["challenger"]
    assert [item["loaded"] for item in body["models"]] == [False, False, False, False, True, True]


def test_models_of_other_robots_are_listed_where_an_alias_names_them(
    own_api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], name="arm-sampler")
    registry.add(bundles["other"], "champion", name="arm-sampler")
    registry.add(bundles["plain"], name="another-sampler")
    # These answer no request.
    for other in ("scene-model", "calibration-lab-3"):
        registry.record(other, "run", {}, alias="champion")
    listed = [item["reference"] for item in own_api.get("/models").json()["models"]]
    assert listed[5:] == ["arm-sampler/2", "pretrained"]
    named = own_api.get("/models?name=arm-sampler").json()["models"]
    assert [item["reference"] for item in named] == ["arm-sampler/2", "arm-sampler/1", "pretrained"]


def test_the_list_without_the_registry_is_that_of_the_cache(
    own_api: ApiClient, registry: CountingRegistry, bundles: dict[str, Path], png: bytes
) -> None:
    registry.add(bundles["other"], "champion", name="arm-sampler")
    assert own_api.post("/sample", files={"image": png}, data={"model": "arm-sampler"}).status_code == 200
    registry.away = True
    body = own_api.get("/models").json()
    assert body["registry"] == "unreachable"
    listed = [item["reference"] for item in body["models"]]
    assert listed == ["cspace-sampler/1", "arm-sampler/1", "pretrained"]


def test_the_list_without_a_champion_marks_the_shipped_model_as_default(start_api: StartApi) -> None:
    (only,) = start_api(None).get("/models").json()["models"]
    assert (only["reference"], only["default"], only["version"]) == ("pretrained", True, 0)
