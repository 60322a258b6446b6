"""A model of depth cameras: pictures with cameras, and what no picture shows."""

import base64
import json
import time

import numpy as np
import pytest

from cspace.bundle import Bundle
from cspace.png import encode_png
from cspace.view_file import pack_view
from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking
from inference_api.requests import Body
from inference_api.routes.plan import query_of
from inference_api.schemas import PlanRequest
from tests.bundles import picture
from tests.cspace.worlds.spatial.test_camera_forms import OPTICAL_TO_BODY, npy, placed
from tests.inference_api.answers import assert_problem
from tests.inference_api.job_work import watched_jobs
from tests.space_bundle import WORLD

MODEL = "panda-sampler@champion"
STATE = ready_rad(WORLD.body).tolist()
ROWS = WORLD.space.sample_uniform(np.random.default_rng(1), 30)


def camera(side):
    values = DepthCamera.of_field(64, 48, 70.0, looking((1.3, side, 0.9), (0.4, 0.0, 0.3))).to_dict()
    return {name: values[name] for name in ("fx", "fy", "cx", "cy", "pose")}


def depth(near_mm):
    found = np.full((48, 64), 2000, np.uint16)
    found[20:30, 10:40] = near_mm
    return found


CAMERAS, DEPTHS = [camera(0.6), camera(-0.7)], [depth(900), depth(1100)]
IMAGES = [encode_depth(one) for one in DEPTHS]


@pytest.fixture(scope="module")
def bundle(space_bundle):
    return Bundle.load(space_bundle)


@pytest.fixture(scope="module")
def api(space_api):
    return space_api


def ask(api, images=tuple(IMAGES), cameras=tuple(CAMERAS), page="/sample", **fields):
    files = [("image", image) for image in images]
    data = {"model": MODEL, "camera": [json.dumps(one) for one in cameras], **fields}
    return api.post(page, files=files, data=data)


def as_read(bundle, images=tuple(IMAGES), cameras=tuple(CAMERAS), state=None):
    return bundle.prepare(bundle.spec.world.read_picture(pack_view(images, cameras, state)))


def test_samples_come_with_confidence_and_the_unseen_share(api, bundle):
    body = ask(api, n="20", seed="3", state=json.dumps(STATE)).json()
    expected = bundle.sample(as_read(bundle, state=STATE), 20, 3)
    np.testing.assert_array_equal(np.array(body["samples"], np.float32), expected.samples)
    np.testing.assert_array_equal(np.array(body["confidence"], np.float32), expected.confidence)
    np.testing.assert_array_equal(np.array(body["unseen"], np.float32), expected.unseen)
    assert body["joint_space"]["kind"] == "box"
    assert 0.0 < np.mean(body["unseen"]) < 1.0


def test_one_picture_shows_less_than_two(api):
    def unseen(count):
        answer = ask(
            api, IMAGES[:count], CAMERAS[:count], "/validity", configurations=json.dumps(ROWS.tolist())
        )
        return np.array(answer.json()["unseen"])

    one, two = unseen(1), unseen(2)
    assert (two <= one + 1e-6).all()
    assert two.mean() < one.mean()


def test_json_and_a_form_are_answered_alike(api, bundle):
    body = {
        "model": MODEL,
        "image": [base64.b64encode(image).decode() for image in IMAGES],
        "camera": CAMERAS,
        "state": STATE,
        "configurations": ROWS.tolist(),
    }
    form = ask(
        api, page="/validity", state=json.dumps(STATE), configurations=json.dumps(ROWS.tolist())
    ).json()
    plain = api.post("/validity", json=body).json()
    for name in ("confidence", "unseen"):
        assert form[name] == plain[name]
    expected = bundle.predict(as_read(bundle, state=STATE), ROWS.astype(np.float32))
    np.testing.assert_array_equal(np.array(form["confidence"], np.float32), expected[0])
    single = body | {"image": body["image"][0], "camera": CAMERAS[0]}
    assert api.post("/validity", json=single).status_code == 200


MOVED = [STATE[0] + 0.5, *STATE[1:]]


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
    goal = [STATE[0] + 1.2, *STATE[1:]]
    ends = {"start": json.dumps(STATE), "goal": json.dumps(goal), "next_view": "true", "time_limit_s": "10"}
    rows = {"configurations": json.dumps(ROWS.tolist())}
    for page, fields, names in (
        ("/sample", {"n": "9", "seed": "1"}, ("samples", "confidence", "warnings")),
        ("/validity", rows, ("confidence", "unseen")),
        ("/plan", ends | {"seed": "1"}, ("path", "next_view")),
        ("/doctor", {}, ("verdicts", "poses")),
    ):
        usual = ask(api, cameras=by_hand, page=page, state=json.dumps(states), **fields).json()
        found = ask(api, cameras=links, page=page, state=[json.dumps(one) for one in states], **fields).json()
        assert [found[name] for name in names] == [usual[name] for name in names]
    image = [base64.b64encode(image).decode() for image in IMAGES]
    body = {"model": MODEL, "image": image, "camera": links, "state": states, "configurations": ROWS.tolist()}
    view = {"image": pack_view(IMAGES, links, states), "configurations": rows["configurations"]}
    expected = ask(api, cameras=by_hand, page="/validity", state=json.dumps(states), **rows).json()
    for answer in (
        api.post("/validity", json=body),
        api.post("/validity", files={"image": view["image"]}, data={"model": MODEL, **rows}),
    ):
        assert answer.json()["unseen"] == expected["unseen"]
    one = ask(api, cameras=by_hand, page="/validity", state=json.dumps(STATE), **rows).json()
    assert one["unseen"] != expected["unseen"]


@pytest.mark.parametrize("as_file", [False, True])
@pytest.mark.parametrize("page", ["/sample", "/validity", "/doctor"])
def test_pictures_that_are_too_old_or_from_the_future_are_refused_and_known_ones_are_not_read_again(
    api, page, as_file
):
    cameras = [one | {"cx": 30.0 + len(page) + 0.25 * as_file} for one in CAMERAS]

    def stamped(*ages_s, **more):
        values = [
            one if age is None else one | {"stamp_s": time.time() - age}
            for one, age in zip(cameras, ages_s, strict=True)
        ]
        fields = {"configurations": json.dumps([STATE])} if page == "/validity" else {}
        if not as_file:
            return ask(api, cameras=values, page=page, state=json.dumps(STATE), **fields, **more)
        view = pack_view(IMAGES, values, STATE)
        return api.post(page, files={"image": view}, data={"model": MODEL, **fields, **more})

    def refused(answer, name="invalid-image"):
        return assert_problem(answer, 422, name)["detail"]

    first, again = stamped(0.0, 1.0, max_age_s="60"), stamped(2.0, None)
    assert (first.status_code, again.status_code) == (200, 200), first.text
    if page != "/doctor":
        assert first.json()["timing_ms"]["decode"] > 0.0
        assert again.json()["timing_ms"]["decode"] == 0.0
    # The picture is known, and its age is looked at all the same.
    assert "picture 1 is 9" in refused(stamped(0.0, 90.0, max_age_s="60"))
    assert "picture 0 is from 2" in refused(stamped(-30.0, 0.0, max_age_s="60"))
    assert "future" in refused(stamped(-30.0, 0.0, max_age_s="60"))
    assert stamped(-0.5, 0.0, max_age_s="60").status_code == 200
    assert stamped(900.0, -30.0).status_code == 200
    assert "picture 1 has no stamp" in refused(stamped(0.0, None, max_age_s="60"), "invalid-value")
    refused(stamped(0.0, 0.0, max_age_s="0"), "invalid-value")
    cameras[0] = cameras[0] | {"stamp_s": "today"}
    assert "stamp_s does not fit" in refused(stamped(None, 0.0))


def test_a_view_file_is_the_same_in_one_field(api):
    view = pack_view(IMAGES, CAMERAS, STATE)
    fields = {"model": MODEL, "n": "9", "seed": "2"}
    one = api.post("/sample", files={"image": view}, data=fields).json()
    several = ask(api, n="9", seed="2", state=json.dumps(STATE)).json()
    assert one["samples"] == several["samples"]


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


@pytest.mark.parametrize("page", ["/sample", "/plan"])
def test_floats_and_messages_of_ros_are_answered_as_mm_and_matrices(api, page):
    goal = [STATE[0] + 1.2, *STATE[1:]]
    ends = {"start": json.dumps(STATE), "goal": json.dumps(goal), "next_view": "true", "time_limit_s": "10"}
    fields = {"page": page, "seed": "1", **({"n": "9"} if page == "/sample" else ends)}
    usual = ask(api, **fields, state=json.dumps(STATE)).json()
    other = ask(api, FLOATS, OTHER_CAMERAS, **fields, state=json.dumps(STATE)).json()
    for name in ("samples", "confidence", "warnings") if page == "/sample" else ("path", "next_view"):
        assert other[name] == usual[name]


def test_a_large_picture_of_floats_fits_into_a_form_and_into_json(api):
    metres = npy(np.full((1024, 1280), 1.5, np.float32))
    camera = CAMERAS[0] | {"fx": 900.0, "fy": 900.0, "cx": 639.5, "cy": 511.5}
    body = {"model": MODEL, "camera": camera, "image": base64.b64encode(metres).decode(), "n": 3, "seed": 1}
    form, plain = ask(api, [metres], [camera], n="3", seed="1"), api.post("/sample", json=body)
    assert (form.status_code, plain.status_code) == (200, 200)
    assert form.json()["samples"] == plain.json()["samples"]


def test_an_array_has_the_unseen_share_in_its_second_column(api, bundle):
    files = [("image", image) for image in IMAGES]
    data = {"model": MODEL, "camera": [json.dumps(one) for one in CAMERAS]}
    data["configurations"] = json.dumps(ROWS.tolist())
    answer = api.post("/validity", files=files, data=data, headers={"accept": "application/x-npy"})
    columns = np.frombuffer(answer.content[-ROWS.size // 7 * 8 :], "<f4").reshape(-1, 2)
    np.testing.assert_array_equal(columns.T, bundle.predict(as_read(bundle), ROWS.astype(np.float32)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cameras": CAMERAS[:1]}, "2 pictures, 1 cameras"),
        ({"cameras": []}, "image is repeated"),
        ({"images": IMAGES[:1], "cameras": []}, "comes without its camera"),
        ({"cameras": [CAMERAS[0], CAMERAS[1] | {"fx": -300.0}]}, "focal"),
        ({"cameras": [CAMERAS[0], CAMERAS[1] | {"pose": np.diag([1, 1, 2, 1]).tolist()}]}, "rotation"),
        ({"cameras": [CAMERAS[0], {"fx": 1.0}]}, "the camera"),
        ({"images": [IMAGES[0], encode_png(picture())]}, "16-bit"),
        ({"images": [IMAGES[0], encode_depth(np.zeros((48, 64), np.uint16))]}, "no reading"),
        ({"images": IMAGES * 3, "cameras": CAMERAS * 3}, "6 pictures"),
        ({"state": "[0, 0]"}, "the state does not fit the robot"),
        (
            {"images": IMAGES[:1], "cameras": CAMERAS[:1], "model": "cspace-sampler"},
            "comes with a camera",
        ),
    ],
)
def test_pictures_and_cameras_that_do_not_fit_are_told(api, changes, words):
    answer = ask(api, **changes)
    name = "invalid-value" if words in ("image is repeated",) else "invalid-image"
    assert words in json.dumps(assert_problem(answer, 422, name))


def test_models_of_both_worlds_are_served_side_by_side(api, png):
    flat = api.post("/sample", files={"image": png}, data={"n": "3"})
    assert (flat.status_code, flat.json()["unseen"]) == (200, None)
    assert ask(api, n="3").status_code == 200


def test_a_way_is_planned_in_what_depth_pictures_show(api, bundle):
    goal = list(STATE)
    goal[0] += 1.2
    fields = {"start": json.dumps(STATE), "goal": json.dumps(goal), "state": json.dumps(STATE), "seed": "1"}
    answer = ask(api, page="/plan", time_limit_s="10", **fields).json()
    assert answer["status"] == "solved", answer["reason"]
    assert np.allclose([answer["path"][0], answer["path"][-1]], [STATE, goal], atol=1e-6)
    assert len(answer["unseen"]) == len(answer["edges"]) == len(answer["path"]) - 1
    assert 0.0 <= min(answer["unseen"]) <= max(answer["unseen"]) <= 1.0
    assert answer["joint_space"]["kind"] == "box"
    ends = np.asarray(answer["path"], np.float32)
    alternative = bundle.predict(as_read(bundle, state=STATE), ends)[0]
    edges = np.asarray(answer["edges"])
    assert (edges <= alternative[1:] + 1e-5).all()
    assert (edges <= alternative[:-1] + 1e-5).all()


def test_the_search_for_a_view_knows_from_where_the_pictures_are():
    ends = {"start": STATE, "goal": STATE, "model": "panda-sampler"}
    images = [base64.b64encode(one).decode() for one in IMAGES]
    body = json.dumps(ends | {"image": images, "camera": CAMERAS}).encode()
    assert query_of(PlanRequest.read(Body(body).values(PlanRequest))).seen_by == tuple(CAMERAS)


def test_a_plan_names_the_view_that_would_see_most_of_its_uncertain_space(api):
    goal = list(STATE)
    goal[0] += 1.2
    fields = {"start": json.dumps(STATE), "goal": json.dumps(goal), "state": json.dumps(STATE), "seed": "1"}
    fields |= {"page": "/plan", "time_limit_s": "10"}
    assert ask(api, **fields).json()["next_view"] is None
    around = ask(api, **fields, next_view="true").json()["next_view"]
    assert 0.0 < around["sees"] <= 1.0
    named = [around["camera"], around["camera"] | {"pose": CAMERAS[0]["pose"]}]
    chosen = ask(api, **fields, view=[json.dumps(one) for one in named]).json()["next_view"]
    assert chosen == around
    refused = ask(api, **fields, next_view="true", min_confidence="1").json()
    assert (refused["status"], refused["next_view"]) == ("refused", around)
    problem = assert_problem(ask(api, **fields, view=[json.dumps({"fx": 1.0})]), 422, "invalid-value")
    assert "a view is no camera" in problem["detail"]


@pytest.mark.parametrize(
    ("page", "fields"),
    [
        ("/sample", {"n": "1"}),
        ("/validity", {"configurations": json.dumps([STATE])}),
        ("/plan", {"start": json.dumps(STATE), "goal": json.dumps(STATE), "time_limit_s": "0.01"}),
    ],
)
def test_pictures_that_are_not_known_are_read_in_parts_as_long_work(api, monkeypatch, page, fields):
    wide = [one | {"fx": 8.0, "fy": 8.0, "cx": 31.0 + len(page)} for one in CAMERAS]
    long, parts = watched_jobs(monkeypatch)
    answer = ask(api, cameras=wide, page=page, state=json.dumps(STATE), **fields)
    assert answer.status_code == 200, answer.text
    assert long()
    # Each picture by runs of the space about its surfaces, whatever its size and focal length.
    assert parts() > 2 * 60
