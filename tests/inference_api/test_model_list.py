from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi


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


def test_the_list_without_a_champion_marks_the_shipped_model_as_default(start_api: StartApi) -> None:
    (only,) = start_api(None).get("/models").json()["models"]
    assert (only["reference"], only["default"], only["version"]) == ("pretrained", True, 0)
