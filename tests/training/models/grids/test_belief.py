"""A scene model asked with a ball: the same answers as for an arm's sphere, and probabilities that hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from onnx import TensorProto, helper

from cspace.bundle import Bundle, write_bundle
from cspace.errors import BundleError, BundleIntegrityError, InputError
from cspace.simulator import Split
from cspace.worlds import simulator_of
from tests.bundles import tiny_graphs, tiny_spec
from tests.space_bundle import HEAD, SPEC, WORLD, space_graphs
from training.models.belief import SCENES, Ball, ball, belief_graph
from training.models.checkpoint import seeded_initialisation
from training.models.grid_head import GridHead, counts_of
from training.models.grid_training import map_graph

AWAY_M = 0.5


@pytest.fixture(scope="module")
def head() -> GridHead:
    with seeded_initialisation(0):
        return GridHead.of(HEAD, WORLD).eval()


def test_a_ball_at_a_place_is_a_sphere_of_an_arm_there(head: GridHead) -> None:
    swung = ball(WORLD.grid_arm(HEAD.grid.groups))
    there = np.array([[AWAY_M, 0.0, 0.0, WORLD.sensor.grid.voxel_m]])
    arm = replace(swung, spheres_m=np.concatenate([there, there]), group_spheres_m=there)
    angles = torch.linspace(-3.0, 3.0, 50)
    places = torch.stack([AWAY_M * torch.cos(angles), AWAY_M * torch.sin(angles), 0.0 * angles], dim=1)
    image = torch.from_numpy(WORLD.sensor.to_network(simulator_of(WORLD).render(scene())[None]))
    with torch.no_grad():
        table = head.encode(image)
        by_arm = GridHead(head.model, arm, counts_of(WORLD))(image, table, angles[None, :, None]).clear[0]
        odds = Ball(head.model, WORLD).log_odds(image, table, places)
    torch.testing.assert_close(torch.sigmoid(-odds), by_arm.exp(), atol=1e-5, rtol=0.0)


def scene() -> Any:
    (found,) = simulator_of(WORLD).scenes(Split.DEMO, 0, 1)
    return found


@pytest.mark.slow
def test_probabilities_hold_where_no_camera_looks(head: GridHead, tmp_path: Path) -> None:
    graphs = {**space_graphs(), "map": map_graph(head), "belief": belief_graph(head.model, WORLD)}
    bundle = Bundle.load(write_bundle(tmp_path / "bundle", SPEC, graphs))
    simulator, expected, truth = simulator_of(WORLD), [], []
    for scenario in simulator.scenes(Split.VALIDATION, 0, SCENES):
        found = bundle.belief(simulator.render(scenario))
        places, distances = simulator.unseen_places(scenario)
        cells = np.floor((places - found.low_m) / found.cell_m).astype(int)
        expected.append(found.occupied[tuple(cells.T)].mean())
        truth.append((distances < found.cell_m / 2.0).mean())
    # Nothing of the head is trained, so all that it knows is how often something is there.
    assert np.mean(expected) == pytest.approx(np.mean(truth), abs=0.01)


def constant(value: float) -> bytes:
    """A graph that expects the same everywhere."""
    takes = {"image": [1, 2, 80, 80, 80], "map": [8000, 4], "places": ["places", 3]}
    nodes = [
        helper.make_node("ReduceMean", ["places", "axis"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "nothing"], ["none"]),
        helper.make_node("Add", ["none", "value"], ["occupied"]),
    ]
    weights = [
        helper.make_tensor("axis", TensorProto.INT64, [1], [1]),
        helper.make_tensor("nothing", TensorProto.FLOAT, [], [0.0]),
        helper.make_tensor("value", TensorProto.FLOAT, [], [value]),
    ]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in takes.items()]
    output = helper.make_tensor_value_info("occupied", TensorProto.FLOAT, ["places"])
    graph = helper.make_graph(nodes, "belief", inputs, [output], weights)
    return helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8
    ).SerializeToString()


def test_what_is_no_probability_is_refused(tmp_path: Path) -> None:
    image = simulator_of(WORLD).render(scene())
    for value in (0.25, 1.5):
        graphs = {**space_graphs(), "belief": constant(value)}
        bundle = Bundle.load(write_bundle(tmp_path / str(value), SPEC, graphs))
        if value > 1.0:
            with pytest.raises(BundleError, match="no probabilities"):
                bundle.belief(image)
        else:
            np.testing.assert_array_equal(bundle.belief(image).occupied, np.full((40, 40, 40), value))


def test_a_belief_without_a_map_or_a_space_is_no_bundle(tmp_path: Path) -> None:
    spec = tiny_spec()
    with pytest.raises(BundleIntegrityError):
        write_bundle(tmp_path / "plane", spec, tiny_graphs(spec) | {"belief": constant(0.5)})
    assert not (tmp_path / "plane").exists()
    bundle = Bundle.load(write_bundle(tmp_path / "space", SPEC, space_graphs()))
    assert bundle._graphs.belief is None
    with pytest.raises(InputError, match="cannot tell what it takes the scene to be"):
        bundle.belief(simulator_of(WORLD).render(scene()))
