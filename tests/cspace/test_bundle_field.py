"""The field of a bundle: what a scene is taken to be, and plans that keep away from what no camera sees."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto, helper

from cspace.bundle import Bundle, write_bundle
from cspace.errors import BundleError, InputError
from cspace.plan import Seen
from cspace.simulator import Split
from cspace.worlds import simulator_of, unseen_space
from cspace.worlds.spatial.sensor import FARTHEST, FREE, OUT_OF_VIEW
from tests.space_bundle import SPEC, WORLD, space_graphs

COUNTS = WORLD.sensor.grid.counts
READY = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
NOWHERE = np.empty((0, WORLD.dim))


def constant(value: float) -> bytes:
    """A field that expects the same everywhere."""
    nodes = [
        helper.make_node("ReduceMax", ["image", "axes"], ["most"], keepdims=0),
        helper.make_node("Mul", ["most", "nothing"], ["none"]),
        helper.make_node("Add", ["none", "value"], ["occupancy"]),
    ]
    weights = [
        helper.make_tensor("axes", TensorProto.INT64, [2], [0, 1]),
        helper.make_tensor("nothing", TensorProto.FLOAT, [], [0.0]),
        helper.make_tensor("value", TensorProto.FLOAT, [], [value]),
    ]
    image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 2, *COUNTS])
    output = helper.make_tensor_value_info("occupancy", TensorProto.FLOAT, list(COUNTS))
    graph = helper.make_graph(nodes, "field", [image], [output], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    return model.SerializeToString()


@cache
def picture() -> np.ndarray:
    (scene,) = simulator_of(WORLD).scenes(Split.DEMO, 0, 1)
    return simulator_of(WORLD).render(scene)


def bundle_with(folder: Path, value: float) -> Bundle:
    return Bundle.load(write_bundle(folder / "bundle", SPEC, {**space_graphs(), "field": constant(value)}))


def test_what_a_scene_is_taken_to_be_comes_from_the_field(tmp_path: Path) -> None:
    found = bundle_with(tmp_path, 0.25).occupancy_grid(picture())
    np.testing.assert_array_equal(found.occupied, np.full([count // 2 for count in COUNTS], 0.25))


def test_what_is_no_probability_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BundleError):
        bundle_with(tmp_path, 1.5).occupancy_grid(picture())


def test_a_model_without_a_field_cannot_tell(tmp_path: Path) -> None:
    bundle = Bundle.load(write_bundle(tmp_path / "bundle", SPEC, space_graphs()))
    with pytest.raises(InputError):
        bundle.occupancy_grid(picture())


def seen_as(code: int) -> np.ndarray:
    image = np.zeros((*COUNTS, 2), dtype=np.uint8)
    image[..., 0], image[..., 1] = FARTHEST, code
    return image


def test_an_arm_touches_the_highest_occupancy_within_its_spheres() -> None:
    rng, grid = np.random.default_rng(0), WORLD.sensor.grid
    occupancy = rng.random(COUNTS).astype(np.float16)
    rows = WORLD.space.to_float32(WORLD.space.sample_uniform(rng, 5))
    found = unseen_space(WORLD, seen_as(OUT_OF_VIEW), occupancy, NOWHERE).touched(rows)
    places, moving = grid.centres_m(), WORLD.body.sphere_links() > 0
    radii = WORLD.body.spheres_m()[moving, 3]
    for row, highest in zip(rows, found, strict=True):
        centres = WORLD.body.sphere_centres_m(row[None].astype(float))[0, moving]
        within = np.zeros(COUNTS, dtype=bool)
        for centre, radius in zip(centres, radii, strict=True):
            within |= np.linalg.norm(places - centre, axis=-1) <= radius
        assert highest == occupancy[within].max()


def test_nothing_is_expected_where_the_picture_is_free_and_where_the_arm_stands() -> None:
    full, rows = np.ones(COUNTS, dtype=np.float16), np.array([READY], dtype=np.float32)
    hidden, free = seen_as(OUT_OF_VIEW), seen_as(FREE)
    cases = ((hidden, NOWHERE, 1.0), (free, NOWHERE, 0.0), (hidden, rows.astype(float), 0.0))
    for image, ends, expected in cases:
        space = unseen_space(WORLD, image, full, ends)
        assert space.touched(rows) == expected
        assert space.careful_checker().valid_batch(rows.astype(float)) == (expected == 0.0)


def test_confidence_falls_with_the_occupancy_on_the_way() -> None:
    def surely(rows: np.ndarray) -> tuple[np.ndarray, None]:
        return np.full(len(rows), 0.9, dtype=np.float32), None

    half, start = np.full(COUNTS, 0.5, dtype=np.float16), np.zeros((1, WORLD.dim))
    space = unseen_space(WORLD, seen_as(OUT_OF_VIEW), half, start)
    rows = WORLD.space.to_float32(np.stack([start[0], start[0] + 0.6]))
    confidence, _ = Seen(WORLD, seen_as(OUT_OF_VIEW), surely).beside(space, surely)(rows)
    np.testing.assert_allclose(confidence, [0.9, 0.45], rtol=1e-3)
