"""Depth pictures with their cameras: every form of them, what they do not show, what does not fit."""

import base64
import json
import time
from typing import Any

import httpx
import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.files import encode_png
from cspace.planning.cost import given_free
from cspace.view_file import pack_view
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking
from tests.bundles import picture
from tests.cspace.worlds.spatial.test_camera_forms import OPTICAL_TO_BODY, npy, placed
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient
from tests.space_bundle import WORLD

MODEL = "panda-sampler@champion"
# No arm is in these pictures.
UNCHECKED = {"model": MODEL, "check_pose": "false"}
STATE = ready_rad(WORLD.body).tolist()
MOVED = [STATE[0] + 0.5, *STATE[1:]]
GOAL = [STATE[0] + 1.2, *STATE[1:]]
ROWS = WORLD.space.sample_uniform(np.random.default_rng(1), 30)
CONFIGURATIONS = {"configurations": json.dumps(ROWS.tolist())}
ENDS = {"start": json.dumps(STATE), "goal": json.dumps(GOAL), "time_limit_s": "10", "seed": "1"}


def camera(side: float) -> dict[str, Any]:
    values = DepthCamera.of_field(64, 48, 70.0, looking((1.3, side, 0.9), (0.4, 0.0, 0.3))).to_dict()
    return {name: values[name] for name in ("fx", "fy", "cx", "cy", "pose")}


def depth(near_mm: int) -> np.ndarray:
    found = np.full((48, 64), 2000, np.uint16)
    found[20:30, 10:40] = near_mm
    return found


CAMERAS, DEPTHS = [camera(0.6), camera(-0.7)], [depth(900), depth(1100)]
IMAGES = [encode_depth(one) for one in DEPTHS]
STRETCHED = np.diag([1, 1, 2, 1]).tolist()
FLOATS = [npy(np.where(one == 0, np.nan, one / 1000.0).astype(np.float32)) for one in DEPTHS]
OTHER_CAMERAS = [
    {
        "camera_info": {
            "k": [one["fx"], 0.0, one["cx"], 0.0, one["fy"], one["cy"], 0.0, 0.0, 1.0],
            "d": [0.0] * 5,
            "width": 64,
            "height": 48,
            "distortion_model": "plumb_bob",
        },
        "frame": "body",
        "pose": placed(np.array(one["pose"]) @ OPTICAL_TO_BODY),
    }
    for one in CAMERAS
]


@pytest.fixture(scope="module")
def bundle(space_bundle):
    return Bundle.load(space_bundle)


@pytest.fixture(scope="module")
def api(space_api: ApiClient) -> ApiClient:
    return space_api


def ask(
    api: ApiClient, images: Any = IMAGES, cameras: Any = CAMERAS, page: str = "/validity", **fields: Any
) -> httpx.Response:
    data = UNCHECKED | {"camera": [json.dumps(one) for one in cameras]}
    data |= CONFIGURATIONS if page == "/validity" else {}
    return api.post(page, files=[("image", image) for image in images], data=data | fields)


def as_read(bundle: Bundle, state: object = None):
    return bundle.prepare(bundle.spec.world.read_picture(pack_view(IMAGES, CAMERAS, state)))


def test_samples_come_with_confidence_and_the_unseen_share(api, bundle):
    body = ask(api, page="/sample", n="20", seed="3", state=json.dumps(STATE)).json()
    expected = bundle.sample(as_read(bundle, STATE), 20, 3)
    for name in ("samples", "confidence", "unseen"):
        np.testing.assert_array_equal(np.array(body[name], np.float32), getattr(expected, name))
    assert body["joint_space"]["kind"] == "box"
    assert 0.0 < np.mean(body["unseen"]) < 1.0


def test_every_form_of_the_same_pictures_has_the_same_answer(api, bundle):
    confidence, unseen = bundle.predict(as_read(bundle, STATE), ROWS.astype(np.float32))
    images = [base64.b64encode(one).decode() for one in IMAGES]
    body = {"model": MODEL, "image": images, "camera": CAMERAS, "check_pose": False}
    state = json.dumps(STATE)
    view = {"files": {"image": pack_view(IMAGES, CAMERAS, STATE)}, "data": UNCHECKED | CONFIGURATIONS}
    for answer in (
        ask(api, state=state),
        ask(api, FLOATS, OTHER_CAMERAS, state=state),
        ask(api, [encode_depth(5 * one) for one in DEPTHS], state=state, depth_scale_m="0.0002"),
        api.post("/validity", json=body | {"state": STATE, "configurations": ROWS.tolist()}),
        api.post("/validity", **view),
    ):
        assert answer.status_code == 200, answer.text
        np.testing.assert_array_equal(np.array(answer.json()["confidence"], np.float32), confidence)
        np.testing.assert_array_equal(np.array(answer.json()["unseen"], np.float32), unseen)
    array = api.post("/validity", **view, headers={"accept": "application/x-npy"}).content
    columns = np.frombuffer(array[-len(ROWS) * 8 :], "<f4").reshape(-1, 2)
    np.testing.assert_array_equal(columns.T, [confidence, unseen])


def on_link(camera, state):
    """The same camera by the link that it would be on at that state."""
    pose = np.linalg.inv(WORLD.body.link_frames([state])[0, -1]) @ np.array(camera["pose"])
    return camera | {"pose": pose.tolist(), "link": "panda_link7"}


def test_a_wrist_camera_with_a_state_for_each_picture_is_answered_as_the_poses_it_has(api):
    states = [STATE, MOVED]
    links = [on_link(*one) for one in zip(CAMERAS, states, strict=True)]
    frames = [WORLD.body.link_frames([state])[0, -1] for state in states]
    by_hand = [
        one | {"pose": (frame @ np.array(link["pose"])).tolist()}
        for one, link, frame in zip(CAMERAS, links, frames, strict=True)
    ]
    for page, fields, names in (
        ("/sample", {"n": "9", "seed": "1"}, ("samples", "confidence", "warnings")),
        ("/validity", {}, ("confidence", "unseen")),
        ("/plan", ENDS, ("path", "unseen")),
        ("/doctor", {}, ("verdicts", "poses")),
    ):
        usual = ask(api, cameras=by_hand, page=page, state=json.dumps(states), **fields).json()
        found = ask(api, cameras=links, page=page, state=[json.dumps(one) for one in states], **fields).json()
        assert [found[name] for name in names] == [usual[name] for name in names]
    one = ask(api, cameras=by_hand, state=json.dumps(STATE)).json()
    assert one["unseen"] != ask(api, cameras=links, state=json.dumps(states)).json()["unseen"]


@pytest.mark.parametrize("as_file", [False, True])
def test_pictures_that_are_too_old_or_from_the_future_are_refused_and_known_ones_are_not_read_again(
    api, as_file
):
    cameras = [one | {"cx": 30.0 + 0.25 * as_file} for one in CAMERAS]

    def stamped(*ages_s: float | None, **more: str) -> httpx.Response:
        values = [
            one if age is None else one | {"stamp_s": time.time() - age}
            for one, age in zip(cameras, ages_s, strict=True)
        ]
        if not as_file:
            return ask(api, cameras=values, state=json.dumps(STATE), **more)
        view = pack_view(IMAGES, values, STATE)
        return api.post("/validity", files={"image": view}, data=UNCHECKED | CONFIGURATIONS | more)

    first, again = stamped(0.0, 1.0, max_age_s="60"), stamped(2.0, None)
    assert first.json()["timing_ms"]["decode"] > 0.0
    assert again.json()["timing_ms"]["decode"] == 0.0
    # The picture is known, and its age is looked at all the same.
    for ages, name, words in (
        ((0.0, 90.0), "invalid-image", "picture 1 is 9"),
        ((-30.0, 0.0), "invalid-image", "picture 0 is from 2"),
        ((0.0, None), "invalid-value", "picture 1 has no stamp"),
    ):
        assert words in assert_problem(stamped(*ages, max_age_s="60"), 422, name)["detail"]
    assert stamped(-0.5, 0.0, max_age_s="60").status_code == 200
    assert stamped(900.0, -30.0).status_code == 200


def test_a_large_picture_of_floats_fits_into_a_form_and_into_json(api):
    metres = npy(np.full((1024, 1280), 1.5, np.float32))
    camera = CAMERAS[0] | {"fx": 900.0, "fy": 900.0, "cx": 639.5, "cy": 511.5}
    body = {"model": MODEL, "camera": camera, "image": base64.b64encode(metres).decode(), "n": 3, "seed": 1}
    form = ask(api, [metres], [camera], "/sample", n="3", seed="1")
    assert form.status_code == 200, form.text
    assert form.json()["samples"] == api.post("/sample", json=body).json()["samples"]


@pytest.mark.parametrize(
    ("changes", "name", "words"),
    [
        ({"cameras": CAMERAS[:1]}, "invalid-image", "2 pictures, 1 cameras"),
        ({"cameras": []}, "invalid-value", "image is repeated"),
        ({"cameras": [], "depth_scale_m": "1"}, "invalid-value", "without a camera"),
        ({"images": IMAGES[:1], "cameras": []}, "invalid-image", "comes without its camera"),
        ({"cameras": [CAMERAS[0], CAMERAS[1] | {"fx": -300.0}]}, "invalid-image", "focal"),
        ({"cameras": [CAMERAS[0], CAMERAS[1] | {"pose": STRETCHED}]}, "invalid-image", "rotation"),
        ({"cameras": [CAMERAS[0], {"fx": 1.0}]}, "invalid-value", "camera.1"),
        ({"images": [IMAGES[0], encode_png(picture())]}, "invalid-image", "16-bit"),
        ({"images": [IMAGES[0], encode_depth(np.zeros((48, 64), np.uint16))]}, "invalid-image", "no reading"),
        ({"images": IMAGES * 3, "cameras": CAMERAS * 3}, "invalid-image", "6 pictures"),
        ({"state": "[0, 0]"}, "invalid-image", "the state does not fit the robot"),
        ({"page": "/sample", "model": "cspace-sampler"}, "invalid-image", "comes with a camera"),
    ],
)
def test_pictures_and_cameras_that_do_not_fit_are_refused(api, changes, name, words):
    answer = ask(api, **changes)
    assert words in json.dumps(assert_problem(answer, 422, name))


def test_a_path_is_planned_in_what_depth_pictures_show(api, bundle):
    answer = ask(api, page="/plan", **ENDS, state=json.dumps(STATE)).json()
    assert answer["status"] == "solved", answer["reason"]
    assert np.allclose([answer["path"][0], answer["path"][-1]], [STATE, GOAL], atol=1e-6)
    assert len(answer["unseen"]) == len(answer["edges"]) == len(answer["path"]) - 1
    assert 0.0 <= min(answer["unseen"]) <= max(answer["unseen"]) <= 1.0
    path, picture = np.asarray(answer["path"], np.float32), as_read(bundle, STATE)
    predict = given_free(lambda rows: bundle.predict(picture, rows), WORLD.space, np.array([STATE]))
    alone = predict(path)[0]
    assert (np.asarray(answer["edges"]) <= np.minimum(alone[1:], alone[:-1]) + 1e-5).all()


def test_without_a_model_the_only_one_that_fits_pictures_and_joints_answers(
    api: ApiClient, start_api, registry, bundles, space_bundle
) -> None:
    depth = {"camera": [json.dumps(one) for one in CAMERAS]}

    def plan(of: ApiClient, **fields: Any) -> httpx.Response:
        images = [("image", image) for image in IMAGES]
        return of.post("/plan", files=images, data={**depth, **ENDS, **fields})

    assert plan(api).json()["model"]["name"] == "panda-sampler"
    # Of no joints that a model has: the default model says what it takes.
    assert_problem(plan(api, start="[0.0, 0.0, 0.0]", goal="[0.0, 0.0, 1.0]"), 422, "invalid-value")
    registry.add(bundles["plain"], "champion")
    registry.add(space_bundle, "champion", name="panda-sampler")
    registry.add(space_bundle, "champion", name="cell-4")
    problem = assert_problem(plan(start_api(registry)), 422, "invalid-value")
    assert "cell-4, panda-sampler" in problem["expected"]


def test_a_refusal_names_what_is_in_the_way_by_what_is_most_certain(api: ApiClient) -> None:
    tool = WORLD.body.frame_of("tool", np.array(GOAL))
    ball = {"name": "ball", "sphere": {"radius_m": 0.2}, "pose": tool.tolist()}
    known = ask(api, page="/plan", **ENDS, scene=json.dumps([ball])).json()["reason"]
    assert known.startswith("at the goal ")
    assert "touches ball by" in known
    reasons = []
    for goal in ROWS[:12]:
        ends = ENDS | {"goal": json.dumps(goal.tolist()), "time_limit_s": "0.5", "max_risk": "0.0"}
        reasons.append(ask(api, page="/plan", **ends).json()["reason"])
    causes = (
        "at the goal ", "at the start ", "the goal is expected to touch", "the least risk found is",
        "separate parts",
    )  # fmt: skip
    assert [one for one in reasons if one and not any(cause in one for cause in causes)] == []
    assert any("0 was allowed" in one for one in reasons if one)
