"""The Open Inference Protocol for a model of depth cameras: pictures, cameras and the state as tensors."""

import base64
import json

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.view_file import pack_view
from cspace.worlds.spatial.camera import decode_depth
from tests.inference_api.job_work import watched_jobs
from tests.inference_api.tensor_client import INFER, LENGTH, outputs_of
from tests.inference_api.test_depth_pictures import CAMERAS, IMAGES, STATE

URL = INFER.format("panda-sampler")
TYPES = {
    "depth": ("UINT16", "<u2"),
    "intrinsics": ("FP64", "<f8"),
    "poses": ("FP64", "<f8"),
    "state": ("FP64", "<f8"),
}
VIEW = {
    "depth": np.stack([decode_depth(one) for one in IMAGES]),
    "intrinsics": np.array([[one[name] for name in ("fx", "fy", "cx", "cy")] for one in CAMERAS]),
    "poses": np.array([one["pose"] for one in CAMERAS]),
    "state": np.array(STATE),
}


@pytest.fixture(scope="module")
def bundle(space_bundle):
    return Bundle.load(space_bundle)


@pytest.fixture(scope="module")
def api(space_api):
    return space_api


def ask(api, view, **parameters):
    """All tensors as bytes behind the JSON object."""
    arrays = {name: np.asarray(array).astype(TYPES.get(name, ("", "<f4"))[1]) for name, array in view.items()}
    inputs = [
        {
            "name": name,
            "datatype": TYPES.get(name, ("FP32", ""))[0],
            "shape": list(array.shape),
            "parameters": {"binary_data_size": array.nbytes},
        }
        for name, array in arrays.items()
    ]
    head = json.dumps({"inputs": inputs, "parameters": parameters}).encode()
    content = head + b"".join(array.tobytes() for array in arrays.values())
    return api.post(URL, content=content, headers={LENGTH: str(len(head))})


def test_samples_are_those_of_the_same_pictures_as_files(api, bundle):
    for state in (None, STATE):
        view = {name: array for name, array in VIEW.items() if state or name != "state"}
        found = outputs_of(ask(api, view, n=20, seed=3))
        read = bundle.spec.world.read_picture(pack_view(IMAGES, CAMERAS, state))
        expected = bundle.sample(bundle.prepare(read), 20, 3)
        np.testing.assert_array_equal(found["samples"], expected.samples)
        np.testing.assert_array_equal(found["confidence"], expected.confidence)
        np.testing.assert_array_equal(found["unseen"], expected.unseen)


def test_numbers_in_json_are_the_same(api):
    inputs = [
        {"name": name, "datatype": TYPES[name][0], "shape": list(array.shape), "data": array.ravel().tolist()}
        for name, array in VIEW.items()
    ]
    answer = api.post(URL, json={"inputs": inputs, "parameters": {"n": 20, "seed": 3}})
    np.testing.assert_array_equal(
        outputs_of(answer)["samples"], outputs_of(ask(api, VIEW, n=20, seed=3))["samples"]
    )


def test_the_metadata_tell_the_inputs_and_what_is_unseen(api):
    metadata = api.get("/v2/models/panda-sampler").json()
    inputs = {one["name"]: (one["datatype"], one["shape"]) for one in metadata["inputs"]}
    assert inputs == {
        "depth": ("UINT16", [-1, -1, -1]),
        "intrinsics": ("FP64", [-1, 4]),
        "poses": ("FP64", [-1, 4, 4]),
        "state": ("FP64", [7]),
        "depth_scale_m": ("FP64", [1]),
        "configurations": ("FP32", [-1, 7]),
    }
    assert [one["name"] for one in metadata["outputs"]][:3] == ["samples", "confidence", "unseen"]
    planar = api.get("/v2/models/pretrained").json()
    assert [one["name"] for one in planar["inputs"]] == ["image"]
    assert "unseen" not in [one["name"] for one in planar["outputs"]]


def test_configurations_are_scored_as_by_the_other_page(api):
    rows = np.random.default_rng(0).uniform(-0.05, 0.05, (40, 7)).astype("<f4") + np.float32(STATE)
    found = outputs_of(ask(api, {**VIEW, "configurations": rows}))
    fields = {
        "image": [base64.b64encode(one).decode() for one in IMAGES],
        "camera": CAMERAS,
        "state": STATE,
        "configurations": rows.tolist(),
        "model": "panda-sampler",
    }
    other = api.post("/validity", json=fields).json()
    assert set(found) == {"confidence", "unseen", "novelty"}
    np.testing.assert_array_equal(found["confidence"], np.float32(other["confidence"]))
    np.testing.assert_array_equal(found["unseen"], np.float32(other["unseen"]))
    assert found["novelty"] == np.float32(other["scenario"]["novelty"])


WRONG = [
    ({**VIEW, "image": VIEW["state"]}, "the inputs are wrong"),
    ({name: VIEW[name] for name in ("depth", "poses")}, "the inputs are wrong"),
    ({**VIEW, "depth": VIEW["depth"][0]}, "the input depth does not fit the model"),
    ({**VIEW, "poses": VIEW["poses"][:1]}, "the input poses does not fit the model"),
    ({**VIEW, "state": VIEW["state"][:6]}, "the input state does not fit the model"),
    ({**VIEW, "state": VIEW["state"] + 9.0}, "the state does not fit the robot"),
    ({**VIEW, "poses": VIEW["poses"] * 2.0}, "pose"),
    ({**VIEW, "intrinsics": VIEW["intrinsics"] * np.nan}, "the depth camera: fx does not fit"),
    ({**VIEW, "depth": VIEW["depth"] * 0}, "a depth picture has no reading"),
    ({name: np.repeat(array, 3, axis=0) for name, array in VIEW.items() if name != "state"}, "c from 1 to 4"),
    ({**VIEW, "depth": VIEW["depth"][:, :8]}, "the depth camera: height does not fit; expected at least 16"),
]


@pytest.mark.parametrize(
    ("view", "message"), WRONG, ids=[f"{n} {message}" for n, (_, message) in enumerate(WRONG)]
)
def test_what_cannot_be_seen_is_told(api, view, message):
    answer = ask(api, view, n=3)
    assert answer.status_code == 400
    assert message in answer.json()["error"]


@pytest.mark.parametrize("further", [{}, {"configurations": np.array([STATE])}])
def test_pictures_are_read_in_parts_as_long_work(api, monkeypatch, further):
    long, parts = watched_jobs(monkeypatch)
    answer = ask(api, VIEW | further, **({} if further else {"n": 1}))
    assert answer.status_code == 200, answer.text
    assert long()
    assert parts() > 2 * 60
