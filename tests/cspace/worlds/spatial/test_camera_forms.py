"""One scene in every form that cameras and depth pictures come in, and the forms that are refused."""

import io
import json
import struct

import numpy as np
import pytest
import yaml
from PIL import Image

from cspace.errors import ImageError
from cspace.view_file import pack_view
from cspace.worlds.spatial.camera import DepthCamera, encode_depth, looking, read_pinhole, undistorted
from cspace.worlds.spatial.view import read_depth
from tests.space_bundle import WORLD

RNG = np.random.default_rng(4)
POSE = looking((1.3, 0.6, 0.9), (0.4, 0.0, 0.3))
CAMERA = DepthCamera.of_field(64, 48, 70.0, POSE)
DEPTH = np.full((48, 64), 2000, np.uint16)
DEPTH[20:30, 10:40] = RNG.integers(600, 1400, (10, 30))
DEPTH[:4] = 0
CAMERA_VALUES = {name: CAMERA.to_dict()[name] for name in ("fx", "fy", "cx", "cy", "pose")}
METRES = np.where(DEPTH == 0, np.nan, DEPTH / 1000.0).astype(np.float32)
METRES[0, :5] = np.inf, -np.inf, -1.0, 0.0, 1e-30


def npy(values):
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def tiff(values, **options):
    file = io.BytesIO()
    Image.fromarray(values).save(file, format="TIFF", **options)
    return file.getvalue()


PICTURES = {
    "16-bit mm": (encode_depth(DEPTH), None),
    "fifths of mm": (encode_depth(DEPTH * np.uint16(5)), 0.0002),
    "TIFF": (tiff(METRES), None),
    "TIFF, LZW as OpenCV writes it": (tiff(METRES, compression="tiff_lzw"), None),
    "TIFF, deflate": (tiff(METRES, compression="tiff_adobe_deflate"), None),
    "npy": (npy(METRES), None),
    "npy by columns": (npy(np.asfortranarray(METRES)), None),
    "npy in mm": (npy(METRES * np.float32(1000.0)), 0.001),
}

OPTICAL_TO_BODY = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
BODY = POSE @ OPTICAL_TO_BODY


def quaternion(matrix):
    """x, y, z, w of a rotation whose w is not near 0."""
    w = 0.5 * np.sqrt(1.0 + np.trace(matrix[:3, :3]))
    turns = (matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1])
    return [*(turn / (4.0 * w) for turn in turns), w]


def placed(matrix):
    return {"translation": matrix[:3, 3].tolist(), "quaternion_xyzw": quaternion(matrix)}


K = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
ROI = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
INFO = {
    "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "camera_depth_optical_frame"},
    "height": 48, "width": 64, "distortion_model": "plumb_bob", "d": [0.0] * 5, "k": K,
    "r": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], "p": [*K[:3], 0.0, *K[3:6], 0.0, *K[6:], 0.0],
    "binning_x": 0, "binning_y": 0, "roi": ROI,
}  # fmt: skip
ECHOED = yaml.safe_dump(INFO | {"distortion_model": "rational_polynomial", "d": [0.0] * 8}) + "---\n"
CALIBRATED = yaml.safe_dump(
    {
        "image_width": 64, "image_height": 48, "camera_name": "depth", "distortion_model": "plumb_bob",
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5},
    }
)  # fmt: skip
CAMERAS = {
    "pinhole and matrix": CAMERA_VALUES,
    "the frame by its name": CAMERA_VALUES | {"frame": "optical"},
    "a body's pose": CAMERA_VALUES | {"frame": "body", "pose": BODY.tolist()},
    "translation and quaternion": CAMERA_VALUES | {"pose": placed(POSE)},
    "a body's quaternion": CAMERA_VALUES | {"frame": "body", "pose": placed(BODY)},
    "CameraInfo of ROS 2": {"camera_info": INFO, "pose": CAMERA_VALUES["pose"]},
    "CameraInfo of ROS 1": {
        "camera_info": {"K": K, "D": [], "width": 64, "height": 48, "distortion_model": ""},
        "pose": CAMERA_VALUES["pose"],
    },
    "what ros2 topic echo prints": {"camera_info": ECHOED, "pose": placed(POSE)},
    "a calibration's file": {"camera_info": CALIBRATED, "pose": CAMERA_VALUES["pose"]},
    "JSON as a text": {"camera_info": json.dumps(INFO), "pose": CAMERA_VALUES["pose"]},
}


@pytest.fixture(scope="module")
def expected():
    return WORLD.read_picture(pack_view([encode_depth(DEPTH)], [CAMERA_VALUES], None))


@pytest.mark.parametrize("name", PICTURES)
def test_one_scene_is_one_array_whatever_file_shows_it(name, expected):
    data, scale = PICTURES[name]
    np.testing.assert_array_equal(read_depth(data, scale), DEPTH)
    np.testing.assert_array_equal(
        WORLD.read_picture(pack_view([data], [CAMERA_VALUES], None, scale)), expected
    )


@pytest.mark.parametrize("name", CAMERAS)
def test_one_scene_is_one_array_however_its_camera_is_written(name, expected):
    data = pack_view([encode_depth(DEPTH)], [CAMERAS[name]], None)
    np.testing.assert_array_equal(WORLD.read_picture(data), expected)


def altered(data, tag, value):
    """A little-endian TIFF of Pillow's with one short or long field changed."""
    found, (at,) = bytearray(data), struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for place in range(at + 2, at + 2 + 12 * count, 12):
        if struct.unpack_from("<H", data, place)[0] == tag:
            struct.pack_into("<I", found, place + 8, value)
            return bytes(found)
    raise AssertionError(tag)


GREEDY = b"II*\0" + struct.pack("<IH", 8, 64) + b"".join(
    struct.pack("<HHII", 40000 + number, 1, 2**31, 8) for number in range(64)
)  # fmt: skip
REFUSED_PICTURES = {
    "nothing": b"",
    "a JPEG": b"\xff\xd8\xff\xe0" + bytes(100),
    "npy of float64": npy(METRES.astype(np.float64)),
    "npy of objects": npy(np.array([[{}]], dtype=object)),
    "npy cut": npy(METRES)[:-1],
    "npy too small": npy(METRES[:9]),
    "TIFF of 16 bits": tiff(DEPTH),
    "TIFF of RGB": tiff(np.zeros((48, 64, 3), np.uint8)),
    "TIFF cut": tiff(METRES)[:-200],
    "TIFF too large": altered(tiff(METRES), 256, 2049),
    "TIFF of two pictures": tiff(METRES, save_all=True, append_images=[Image.fromarray(METRES)]),
    "TIFF that names 128 GiB": GREEDY,
}


@pytest.mark.parametrize("name", REFUSED_PICTURES)
def test_other_pictures_are_refused(name):
    with pytest.raises(ImageError):
        read_depth(REFUSED_PICTURES[name])


def test_floats_beyond_what_a_camera_reads_stay_out_of_range_so_that_a_wrong_unit_shows():
    with pytest.raises(ImageError):
        WORLD.read_picture(pack_view([npy(METRES * np.float32(1000.0))], [CAMERA_VALUES], None))


FISHEYE = INFO | {"distortion_model": "equidistant", "d": [0.0] * 4}
REFUSED_CAMERAS = {
    "another model": {"camera_info": FISHEYE},
    "coefficients without a model": {"camera_info": INFO | {"distortion_model": "", "d": [0.1]}},
    "thin prisms": {
        "camera_info": INFO | {"distortion_model": "rational_polynomial", "d": [0.0] * 8 + [0.1, 0, 0, 0]}
    },
    "a lens that folds": {"camera_info": INFO | {"d": [-5.0, 0.0, 0.0, 0.0, 0.0]}},
    "another size": {"camera_info": INFO | {"width": 128, "height": 96}},
    "binning": {"camera_info": INFO | {"binning_x": 2, "binning_y": 2}},
    "a region of interest": {"camera_info": INFO | {"roi": ROI | {"x_offset": 8}}},
    "no k": {"camera_info": {"width": 64, "height": 48}},
    "an uncalibrated camera": {"camera_info": INFO | {"k": [0.0] * 9}},
    "a text that is no YAML": {"camera_info": "k: ["},
    "CameraInfo beside": INFO,
    "half a camera": {"fx": 50.0},
    "both": {"camera_info": INFO, "fx": 50.0},
    "an unnamed order": CAMERA_VALUES
    | {"pose": {"translation": [0.0] * 3, "quaternion": [0.0, 0.0, 0.0, 1.0]}},
    "another norm": CAMERA_VALUES | {"pose": placed(POSE) | {"quaternion_xyzw": [0.0, 0.0, 0.0, 0.99]}},
    "a place beyond sight": CAMERA_VALUES | {"pose": placed(POSE) | {"translation": [0.0, 0.0, 1e300]}},
    "another frame": CAMERA_VALUES | {"frame": "camera_link"},
    "a text as a number": CAMERA_VALUES | {"fx": "30"},
    "a focal length that cannot be": CAMERA_VALUES | {"fx": 0.01},
    "a principal point that cannot be": CAMERA_VALUES | {"cx": 500.0},
    "a mirrored pose": CAMERA_VALUES | {"pose": np.diag([-1.0, 1.0, 1.0, 1.0]).tolist()},
}


@pytest.mark.parametrize("name", REFUSED_CAMERAS)
def test_other_cameras_are_refused(name):
    camera = {"pose": CAMERA_VALUES["pose"]} | REFUSED_CAMERAS[name]
    with pytest.raises(ImageError):
        WORLD.read_picture(pack_view([encode_depth(DEPTH)], [camera], None))


def seen_wall(camera, distortion):
    """What a lens shows of a slanted wall: depths (H, W) mm by the rays that its pixels truly have."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(0.0,) * 8)[:8]
    rays = camera.rays()
    bent_x, bent_y = rays[..., 0], rays[..., 1]
    x, y = bent_x, bent_y
    for _ in range(40):
        square = x * x + y * y
        radial = (1 + k1 * square + k2 * square**2 + k3 * square**3) / (
            1 + k4 * square + k5 * square**2 + k6 * square**3
        )
        x, y = (
            (bent_x - 2 * p1 * x * y - p2 * (square + 2 * x * x)) / radial,
            (bent_y - p1 * (square + 2 * y * y) - 2 * p2 * x * y) / radial,
        )
    return np.floor(1000.0 * 1.5 / (1.0 + 0.3 * x - 0.4 * y) + 0.5).astype(np.uint16)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("plumb_bob", (-0.25, 0.08, 0.002, -0.003, -0.01)),
        ("rational_polynomial", (0.45, -0.2, 0.0004, -0.0003, 0.02, 0.6, -0.1, 0.03)),
    ],
)
def test_distortion_is_undone(model, distortion):
    camera = DepthCamera.of_field(320, 240, 70.0, POSE)
    k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    info = {"k": k, "d": list(distortion), "width": 320, "height": 240, "distortion_model": model}
    found, coefficients = read_pinhole({"camera_info": info, "pose": CAMERA_VALUES["pose"]}, (240, 320))
    assert (found, coefficients) == (camera, distortion)
    bent, straight = seen_wall(camera, distortion), seen_wall(camera, ())
    again = undistorted(bent, found, coefficients)
    read = again > 0
    # A reading is of half a pixel beside, along both sides.
    half = sum(0.5 * np.abs(np.diff(straight.astype(int), axis=axis)).max() for axis in (0, 1))
    assert np.abs(again.astype(int) - straight)[read].max() <= half + 2
    assert np.abs(bent.astype(int) - straight).max() > 4 * half
    assert read.mean() > 0.85
    assert read[50:-50, 50:-50].all()
