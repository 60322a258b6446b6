"""Pictures as the client sends them, read by what the server reads them with."""

import io
import json

import numpy as np
import pytest
from PIL import Image
from pydantic import ValidationError

from cspace.worlds.planar.camera import decode_png
from cspace.worlds.spatial.view import read_depth
from cspace_client import DepthPictures, Known, PlanarPicture, SamplerError
from cspace_client.pictures import encode_png, form_of, shown
from tests.bundles import picture

CAMERA = {"fx": 46.0, "fy": 46.0, "cx": 31.5, "cy": 23.5, "pose": np.eye(4)}
DEPTH = np.random.default_rng(0).integers(0, 2**16, (48, 64)).astype(np.uint16)


def test_pixels_arrive_as_they_are():
    image = np.random.default_rng(0).integers(0, 256, (48, 48, 3)).astype(np.uint8)
    for pixels in (image, picture(), np.asfortranarray(image)):
        np.testing.assert_array_equal(decode_png(encode_png(pixels)), pixels)
    for pixels in (DEPTH, DEPTH[::2, ::-1], DEPTH.astype(">u2")):
        data = encode_png(pixels)
        assert data.startswith(b"\x89PNG")
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))).astype(np.uint16), pixels)


def test_depths_in_metres_are_the_same_numbers_in_an_npy_file():
    metres = np.where(DEPTH == 0, np.nan, DEPTH / 1000.0).astype(np.float32)
    for pixels in (metres, metres[::2, ::-1], metres.astype(">f4")):
        ((_, (name, data, kind)),) = shown(DepthPictures([pixels], [CAMERA]))[0]
        assert (name, kind) == ("depth.npy", "application/x-npy")
        np.testing.assert_array_equal(read_depth(data), np.nan_to_num(pixels * 1000.0).round())


def form(picture):
    """The fields beside the files, as a form has them, read again."""
    sent = form_of(shown(picture)[1])
    return {
        name: [json.loads(one) for one in value] if isinstance(value, list) else json.loads(value)
        for name, value in sent.items()
    }


def files(picture, field="image"):
    return [data for name, (_, data, _) in shown(picture)[0] if name == field]


def test_cameras_go_beside_their_pictures_in_the_same_order():
    two = DepthPictures([DEPTH, b"a file"], [CAMERA, CAMERA | {"fx": 7.0}], np.zeros(7))
    assert files(two) == [encode_png(DEPTH), b"a file"]
    sent = form(two)
    assert [one["fx"] for one in sent["camera"]] == [46.0, 7.0]
    assert sent["camera"][0]["pose"] == np.eye(4).tolist()
    assert sent["state"] == [0.0] * 7
    assert list(form(DepthPictures([DEPTH], [CAMERA]))) == ["camera"]
    wrist = CAMERA | {"link": "tool", "stamp_s": np.float64(12.5)}
    sent = form(DepthPictures([DEPTH] * 2, [wrist] * 2, [np.zeros(7), None], max_age_s=0.5))
    assert (sent["state"], sent["max_age_s"]) == ([[0.0] * 7, None], 0.5)
    assert (sent["camera"][1]["link"], sent["camera"][1]["stamp_s"]) == ("tool", 12.5)


def test_what_is_known_goes_beside_a_picture():
    disc = {"name": "pole", "disc": {"x_m": np.float64(1.5), "y_m": 0, "radius_m": 0.3}}
    planar = PlanarPicture(picture(), Known([disc]))
    assert files(planar) == [encode_png(picture())]
    assert form(planar) == {"scene": [disc]}
    leaf = {"name": "leaf", "mesh": {"file": "leaf.stl"}, "pose": {"translation": (0, 0, 1)}}
    known = Known(attached=[leaf], allowed=[("leaf", "tool")], meshes={"leaf.stl": b"solid"})
    deep = DepthPictures([DEPTH], [CAMERA], known=known)
    assert files(deep, "mesh") == [b"solid"]
    sent = form(deep)
    assert sent["allowed"] == [["leaf", "tool"]]
    assert sent["attached"][0]["pose"] == {"translation": [0.0, 0.0, 1.0]}
    assert form(PlanarPicture(b"a file", Known())) == {}


def test_pictures_that_no_request_has_are_refused():
    for pixels in (np.zeros((4, 4)), np.zeros((4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8)):
        with pytest.raises(SamplerError, match="picture"):
            shown(pixels)
    for pictures, cameras in (([], []), ([DEPTH], []), ([DEPTH] * 5, [CAMERA] * 5)):
        with pytest.raises(SamplerError, match="camera"):
            DepthPictures(pictures, cameras)
    with pytest.raises(ValidationError, match="fx"):
        shown(DepthPictures([DEPTH], [CAMERA | {"fx": {1}}]))
    with pytest.raises(ValidationError, match="a body has one of"):
        shown(PlanarPicture(picture(), Known([{"name": "nothing"}])))
