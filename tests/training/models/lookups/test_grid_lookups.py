"""A head's map by look-ups that are made for the grid, against the head itself."""

import itertools
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK
from cspace.worlds.planar.seeing.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from tests.training.paths.test_ways import walled_head
from training.models.export import validity_graph
from training.models.lookups import head_map
from training.models.lookups.grid_lookups import fast_map
from training.models.lookups.head_map import map_graph
from training.models.settings import ValidityConfig
from training.models.validity import make_head

PIXELS = 48
BUNDLES = Path(__file__).parents[3] / "cspace" / "bundles"


def head_of(robot, side_m=0.1) -> bytes:
    torch.manual_seed(0)  # noqa: TID251 - weights that are the same in every run
    config = ValidityConfig(free_share=0.69, hidden=12, layers=2, points_per_link=5, side_m=side_m)
    return validity_graph(
        make_head(config, PlanarWorld(robot, Camera(pixels=PIXELS))).eval(), PIXELS, robot.dim
    )


def grid_of(dim, cells):
    line = (np.arange(cells) + 0.5) / cells * 2.0 * np.pi - np.pi
    return np.array(list(itertools.product(line, repeat=dim)), dtype=np.float32)


def answer(graph, **feeds):
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    return session.run(None, feeds)[0]


def pictures(count):
    return np.random.default_rng(1).uniform(-1, 1, (count, 1, 3, PIXELS, PIXELS)).astype(np.float32)


def test_a_head_that_an_earlier_release_exported_is_read_as_well():
    head = (BUNDLES / "stacked_mixture" / "validity.onnx").read_bytes()
    grid = grid_of(TWO_LINK.dim, 24)
    graph = fast_map(onnx.load_from_string(head), grid)
    for image in pictures(2):
        wanted = answer(head, image=image, configurations=grid)
        assert np.ptp(wanted) > 0.02
        np.testing.assert_allclose(answer(graph.SerializeToString(), image=image), wanted, atol=1e-5)


@pytest.mark.parametrize(
    ("robot", "cells", "side_m"), [(TWO_LINK, 24, 0.1), (TWO_LINK, 7, 0.0), (THREE_LINK, 6, 0.1)]
)
def test_the_fast_map_is_what_the_head_says(robot, cells, side_m):
    head, grid = head_of(robot, side_m), grid_of(robot.dim, cells)
    graph = fast_map(onnx.load_from_string(head), grid)
    onnx.checker.check_model(graph)
    for image in pictures(3):
        wanted = answer(head, image=image, configurations=grid)
        assert np.ptp(wanted) > 0.02
        np.testing.assert_allclose(answer(graph.SerializeToString(), image=image), wanted, atol=1e-5)


def test_a_map_is_made_the_fast_way_where_the_head_is_known():
    names = {
        entry.name
        for entry in onnx.load_from_string(map_graph(head_of(TWO_LINK), grid_of(2, 8))).graph.initializer
    }
    assert any(name.startswith("look_") for name in names)


def test_another_programs_head_is_not_taken_apart():
    assert fast_map(onnx.load_from_string(walled_head()), grid_of(2, 8)) is None


def test_a_fast_map_that_says_something_else_is_not_taken(monkeypatch):
    head, grid = head_of(TWO_LINK), grid_of(2, 8)
    other = fast_map(onnx.load_from_string(head), grid + np.float32(0.5))
    monkeypatch.setattr(head_map, "fast_map", lambda model, cells: other)
    (image,) = pictures(1)
    wanted = answer(head, image=image, configurations=grid)
    np.testing.assert_allclose(answer(map_graph(head, grid), image=image), wanted, atol=1e-5)
