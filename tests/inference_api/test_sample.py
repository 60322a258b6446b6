import base64
import io
import json
import math
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray

from cspace.bundle import Bundle
from cspace.files import encode_png
from cspace.worlds import robot_digest
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.world import PlanarWorld
from tests.bundles import picture
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry

NPY = {"accept": "application/x-npy"}


def ask(api: ApiClient, png: bytes, headers: dict[str, str] | None = None, **fields: Any) -> httpx.Response:
    answer = api.post("/sample", files={"image": ("scenario.png", png)}, data=fields, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer


def samples_of(answer: httpx.Response) -> NDArray[np.float64]:
    return np.array(answer.json()["samples"])


def test_the_answer_has_exactly_the_contracts_members(api: ApiClient, bundles: dict[str, Path]) -> None:
    # No other test sends this picture, so that it has to be read.
    answer = ask(api, encode_png(picture()[::-1]))
    body = answer.json()
    assert samples_of(answer).shape == (300, 2)
    assert np.all(np.isfinite(samples_of(answer)))
    assert set(body) == {
        "samples", "confidence", "unseen", "shortfall", "acceptance", "proposals", "scenario",
        "joint_space", "model", "seed", "timing_ms", "warnings", "ways",
    }  # fmt: skip
    assert body["scenario"] == {"novelty": None}
    assert body["joint_space"] == {"kind": "torus", "dim": 2, "unit": "rad"}
    assert body["model"] == {
        "name": "cspace-sampler",
        "version": 1,
        "alias": "champion",
        "run_id": "run-1",
        "digest": Bundle.load(bundles["plain"]).digest,
        "fallback": False,
        "robot": robot_digest(PlanarWorld()),
        "alias_confirmed": True,
    }
    assert set(body["timing_ms"]) == {"decode", "encode", "generate", "total"}
    parts = [body["timing_ms"][name] for name in ("decode", "encode", "generate")]
    assert all(part > 0 for part in parts)
    assert body["timing_ms"]["total"] >= sum(parts)
    assert (body["confidence"], body["shortfall"], body["acceptance"]) == (None, 0, 1.0)
    assert (body["unseen"], body["warnings"], body["ways"]) == (None, [], None)


def test_form_and_json_mean_the_same(api: ApiClient, png: bytes) -> None:
    form = ask(api, png, n="50", seed="7", epsilon_sigma=["0", "0.5"], model="cspace-sampler/2")
    image = base64.b64encode(png).decode()
    as_json = {"image": image, "n": 50, "epsilon_sigma": [0, 0.5], "model": "cspace-sampler/2"}
    for seed in (7, "7"):
        answer = api.post("/sample", json=as_json | {"seed": seed}).json()
        assert answer["samples"] == form.json()["samples"]
        assert (answer["model"], answer["seed"]) == (form.json()["model"], "7")


def test_a_seed_is_drawn_and_returned_when_absent(api: ApiClient, png: bytes) -> None:
    image = base64.b64encode(png).decode()
    for absent in ({}, {"seed": None, "start": None, "goal": None}):
        body = {"image": image, "n": 5, **absent}
        first, second = (api.post("/sample", json=body).json() for _ in range(2))
        assert first["seed"] != second["seed"]
        again = ask(api, png, n="5", seed=first["seed"]).json()
        assert again["samples"] == first["samples"]


def test_the_samples_are_those_of_the_bundle_and_npy_has_the_rest_in_headers(
    api: ApiClient, png: bytes, bundles: dict[str, Path]
) -> None:
    fields = {"n": "30", "seed": "5", "epsilon_sigma": "0.5"}
    bundle = Bundle.load(bundles["plain"])
    expected = bundle.sample(decode_png(png, 48), 30, 5, epsilon_sigma=(0.5,)).samples
    answer = ask(api, png, NPY, **fields)
    assert answer.headers["content-type"] == "application/x-npy"
    array = np.load(io.BytesIO(answer.content), allow_pickle=False)
    assert array.dtype == np.float32
    np.testing.assert_array_equal(array, expected)
    plain = ask(api, png, **fields).json()
    np.testing.assert_array_equal(plain["samples"], expected)
    assert answer.headers["x-model-name"] == "cspace-sampler"
    assert answer.headers["x-model-version"] == "1"
    assert answer.headers["x-model-digest"] == plain["model"]["digest"]
    assert (answer.headers["x-seed"], answer.headers["x-shortfall"]) == ("5", "0")
    names = [entry.split(";dur=")[0].strip() for entry in answer.headers["server-timing"].split(",")]
    assert names == ["decode", "encode", "generate", "total"]


def test_too_few_within_the_budget_are_told_and_never_padded(
    api: ApiClient, png: bytes, bundles: dict[str, Path]
) -> None:
    fields = {"n": "200", "seed": "3", "model": "cspace-sampler@scored", "min_confidence": "0.7"}
    body = ask(api, png, **fields).json()
    assert 0 < len(body["samples"]) == len(body["confidence"]) == 200 - body["shortfall"] < 200
    assert min(body["confidence"]) >= 0.7
    direct = Bundle.load(bundles["scored"]).sample(decode_png(png, 48), 200, 3, min_confidence=0.7)
    np.testing.assert_array_equal(np.array(body["samples"], dtype=np.float32), direct.samples)
    none = fields | {"n": "20", "min_confidence": "1"}
    body = ask(api, png, **none).json()
    assert (body["samples"], body["confidence"], body["shortfall"]) == ([], [], 20)
    answer = ask(api, png, NPY, **none)
    assert np.load(io.BytesIO(answer.content)).shape == (0, 2)
    assert answer.headers["x-shortfall"] == "20"


def test_without_a_confidence_the_models_own_threshold_holds(api: ApiClient, png: bytes) -> None:
    fields = {"n": "50", "seed": "3", "model": "cspace-sampler@careful"}
    own, explicit = ask(api, png, **fields).json(), ask(api, png, min_confidence="0.45", **fields).json()
    everything = ask(api, png, min_confidence="0", **fields).json()
    assert own["samples"] == explicit["samples"] != everything["samples"]
    assert min(own["confidence"]) >= 0.45 > min(everything["confidence"])


def test_the_novelty_of_the_picture_is_told(api: ApiClient, bundles: dict[str, Path]) -> None:
    bundle = Bundle.load(bundles["careful"])
    grey, white = (encode_png(np.full((48, 48, 3), level, np.uint8)) for level in (150, 255))
    for png in (grey, white, grey):
        expected = bundle.prepare(decode_png(png, 48)).novelty
        assert expected is not None
        fields = {"n": "5", "model": "cspace-sampler@careful", "min_confidence": "0"}
        assert ask(api, png, **fields).json()["scenario"] == {"novelty": pytest.approx(expected)}
        assert float(ask(api, png, NPY, **fields).headers["x-novelty"]) == pytest.approx(expected, abs=1e-5)
    assert "x-novelty" not in ask(api, grey, NPY, n="5").headers


def test_a_picture_is_decoded_and_encoded_once(api: ApiClient) -> None:
    fresh = encode_png(picture(77))
    first, second = (ask(api, fresh, n="20", seed="1").json() for _ in range(2))
    assert first["samples"] == second["samples"]
    assert first["timing_ms"]["decode"] > 0.0 < first["timing_ms"]["encode"]
    assert (second["timing_ms"]["decode"], second["timing_ms"]["encode"]) == (0.0, 0.0)
    # Another model has not seen it.
    other = ask(api, fresh, n="20", seed="1", model="cspace-sampler@challenger").json()
    assert other["timing_ms"]["encode"] > 0.0


def test_path_models_take_start_and_goal_and_wrap_them(api: ApiClient, png: bytes) -> None:
    fields = {"n": "20", "seed": "3", "model": "cspace-sampler@path"}
    here = samples_of(ask(api, png, **fields, start="[0.5, -1.0]", goal="[1, 2]"))
    turned = samples_of(ask(api, png, **fields, start=json.dumps([0.5 - 2 * math.pi, -1.0]), goal="[1, 2]"))
    other = samples_of(ask(api, png, **fields, start="[1, 2]", goal="[0.5, -1.0]"))
    np.testing.assert_allclose(turned, here, atol=1e-5)
    assert not np.allclose(other, here)


@pytest.mark.parametrize(
    ("model", "name", "version", "alias", "fallback"),
    [
        ("cspace-sampler", "cspace-sampler", 1, "champion", False),
        ("cspace-sampler@champion", "cspace-sampler", 1, "champion", False),
        ("cspace-sampler@challenger", "cspace-sampler", 2, "challenger", False),
        ("cspace-sampler/2", "cspace-sampler", 2, None, False),
        ("pretrained", "pretrained", 0, None, False),
    ],
)
def test_every_form_of_reference_answers_with_what_it_names(
    api: ApiClient, png: bytes, model: str, name: str, version: int, alias: str | None, fallback: bool
) -> None:
    found = ask(api, png, n="3", model=model).json()["model"]
    assert found["name"] == name
    assert (found["version"], found["alias"], found["fallback"]) == (version, alias, fallback)


@pytest.mark.parametrize("kind", ["an empty registry", "no registry"])
def test_without_a_champion_the_shipped_model_answers_and_says_so(
    start_api: StartApi, png: bytes, registry: CountingRegistry, kind: str
) -> None:
    api = start_api(registry if kind == "an empty registry" else None)
    found = ask(api, png).json()["model"]
    assert (found["name"], found["version"], found["run_id"]) == ("pretrained", 0, None)
    assert found["fallback"] is True
    assert ask(api, png, NPY).headers["x-model-name"] == "pretrained"
    assert ask(api, png, model="pretrained").json()["model"]["fallback"] is False
    assert api.get("/health/ready").json()["model"]["fallback"] is True


ACCEPT = {
    "*/*": False,
    "application/json": False,
    "application/x-npy": True,
    "APPLICATION/X-NPY; q=0.5": True,
    "application/json;q=0.1, application/x-npy": True,
    "application/json, application/x-npy;q=0.5": False,
    "application/x-npy;q=0": False,
    "application/x-npy;q=high": False,
    "application/x-npy, */*": True,
    ",;,": False,
}


def test_npy_is_sent_to_those_who_ask_for_it(api: ApiClient, png: bytes) -> None:
    for accept, wanted in ACCEPT.items():
        answer = ask(api, png, {"accept": accept}, n="3")
        assert answer.headers["content-type"] == f"application/{'x-npy' if wanted else 'json'}", accept
