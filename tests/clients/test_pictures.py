"""Pictures as the client sends them, read by what the server reads them with."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from cspace.png import canonical_png, read_header
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.spatial.depth_files import read_depth
from cspace_client import DepthPictures, Known, PlanarPicture, SamplerError
from cspace_client.pictures import encode_png, shown
from tests.bundles import picture

CAMERA = {"fx": 46.0, "fy": 46.0, "cx": 31.5, "cy": 23.5, "pose": np.eye(4)}
DEPTH = np.random.default_rng(0).integers(0, 2**16, (48, 64)).astype(np.uint16)


def test_a_picture_in_colour_is_the_same_pixels():
    image = np.random.default_rng(0).integers(0, 256, (48, 48, 3)).astype(np.uint8)
    for pixels in (image, picture(), np.asfortranarray(image)):
        np.testing.assert_array_equal(decode_png(encode_png(pixels)), pixels)


def test_a_depth_picture_is_the_same_numbers():
    for pixels in (DEPTH, DEPTH[::2, ::-1], DEPTH.astype(">u2")):
        data = encode_png(pixels)
        assert canonical_png(data, read_header(data)) == data
        np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(data))).astype(np.uint16), pixels)


def test_depths_in_metres_are_the_same_numbers_in_an_npy_file():
    metres = np.where(DEPTH == 0, np.nan, DEPTH / 1000.0).astype(np.float32)
    for pixels in (metres, metres[::2, ::-1], metres.astype(">f4")):
        ((name, data, kind),) = shown(DepthPictures([pixels], [CAMERA])).files
        assert (name, kind) == ("depth.npy", "application/x-npy")
        np.testing.assert_array_equal(read_depth(data), np.nan_to_num(pixels * 1000.0).round())


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4)),
        np.zeros((4, 4), np.uint8),
        np.zeros((4, 4, 4), np.uint8),
        np.zeros((0, 4, 3), np.uint8),
    ],
    ids=["float", "grey of 8 bits", "with alpha", "empty"],
)
def test_pixels_that_are_no_picture_are_refused(image):
    with pytest.raises(SamplerError, match="picture"):
        shown(image)


def test_cameras_go_beside_their_pictures_in_the_same_order():
    sent = shown(DepthPictures([DEPTH, b"a file"], [CAMERA, CAMERA | {"fx": 7.0}], np.zeros(7)))
    assert [data for _, data, _ in sent.files] == [encode_png(DEPTH), b"a file"]
    first, second = (json.loads(one) for one in sent.fields["camera"])
    assert (first["fx"], second["fx"], first["pose"]) == (46.0, 7.0, np.eye(4).tolist())
    assert json.loads(sent.fields["state"]) == [0.0] * 7
    assert "state" not in shown(DepthPictures([DEPTH], [CAMERA])).fields
    wrist = CAMERA | {"link": "tool", "stamp_s": np.float64(12.5)}
    fields = shown(DepthPictures([DEPTH] * 2, [wrist] * 2, [np.zeros(7), None], max_age_s=0.5)).fields
    assert json.loads(fields["state"]) == [[0.0] * 7, None]
    assert fields["max_age_s"] == "0.5"
    assert {name: json.loads(fields["camera"][1])[name] for name in ("link", "stamp_s")} == {
        "link": "tool",
        "stamp_s": 12.5,
    }


def test_known_discs_go_beside_a_picture_of_the_plane():
    disc = {"name": "pole", "disc": {"x_m": np.float64(1.5), "y_m": 0, "radius_m": 0.3}}
    sent = shown(PlanarPicture(picture(), Known([disc])))
    assert [data for _, data, _ in sent.files] == [encode_png(picture())]
    assert list(sent.fields) == ["scene"]
    assert json.loads(sent.fields["scene"]) == [disc]
    assert shown(PlanarPicture(b"a file", Known())).fields == {}
    with pytest.raises(SamplerError, match="plain values"):
        shown(PlanarPicture(picture(), Known([{"name": {1}}])))


def test_depth_pictures_that_do_not_fit_are_refused():
    for pictures, cameras in (([], []), ([DEPTH], []), ([DEPTH] * 5, [CAMERA] * 5)):
        with pytest.raises(SamplerError, match="camera"):
            DepthPictures(pictures, cameras)
    with pytest.raises(SamplerError, match="plain values"):
        shown(DepthPictures([DEPTH], [CAMERA | {"fx": {1}}]))
