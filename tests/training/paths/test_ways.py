"""The way sampler's graph against a search by another program, on heads whose maps are known."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from cspace.errors import ConfigError
from cspace.grid_search import centres, spacing, ways_to
from cspace.space import difference
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from training.paths.ways import WaySettings, way_graph
from training.paths.writing import PathGraph

LATENT = 3
LIMITED = PlanarArm(joint_limits_rad=(None, (-3.0, 3.0)))
STRAIGHT = WaySettings(tube_rad=0.0, gap_rad=0.0, widest_rad=0.0)


def walled_head(wall_rad: float = 1.0, gap_rad: float = 0.5) -> bytes:
    """Free but for a wall 0.6 rad thick at one angle of the first joint, and one at 3 rad without a gap.

    The first wall has a gap where the second joint is near 0.
    """
    constants = {
        "columns": np.array([1, 1]),
        "wall": np.float32(wall_rad),
        "seam": np.float32(3.0),
        "thick": np.float32(0.3),
        "gap": np.float32(gap_rad),
        "steep": np.float32(40.0),
        "flat": np.array([-1]),
        "zero": np.float32(0.0),
    }
    nodes = [
        helper.make_node("Split", ["configurations", "columns"], ["q0", "q1"], axis=1),
        helper.make_node("Sub", ["q0", "wall"], ["from_wall"]),
        helper.make_node("Abs", ["from_wall"], ["to_wall"]),
        helper.make_node("Sub", ["to_wall", "thick"], ["beside"]),
        helper.make_node("Abs", ["q1"], ["to_middle"]),
        helper.make_node("Sub", ["gap", "to_middle"], ["in_gap"]),
        helper.make_node("Max", ["beside", "in_gap"], ["first"]),
        helper.make_node("Sub", ["seam", "q0"], ["from_seam"]),
        helper.make_node("Abs", ["from_seam"], ["to_seam"]),
        helper.make_node("Sub", ["to_seam", "thick"], ["second"]),
        helper.make_node("Min", ["first", "second"], ["margin"]),
        helper.make_node("Mul", ["margin", "steep"], ["logit"]),
        # The picture is an input that this head does not need.
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["logit", "nothing"], ["sum"]),
        helper.make_node("Sigmoid", ["sum"], ["column"]),
        helper.make_node("Reshape", ["column", "flat"], ["confidence"]),
    ]
    inputs = {"image": (1, 3, 48, 48), "configurations": ("n", 2)}
    graph = helper.make_graph(
        nodes,
        "walls",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in inputs.items()],
        [helper.make_tensor_value_info("confidence", TensorProto.FLOAT, ("n",))],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    return bytes(model.SerializeToString())


def opened(graph: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


class Ways:
    """The two graphs of a path sampler as a bundle runs them."""

    def __init__(self, graph: PathGraph) -> None:
        self._map, self._ways = opened(graph.map), opened(graph.model)

    def run(self, feeds: dict[str, np.ndarray]) -> np.ndarray:
        (seen,) = self._map.run(["map"], {"image": np.zeros((1, 3, 48, 48), np.float32)})
        return self._ways.run(["samples"], feeds | {"map": seen})[0]


def asked(session: Ways, start, goal, place, jitter=None) -> np.ndarray:
    rows = len(place)
    feeds = {
        "latent": np.zeros((rows, LATENT)),
        "place": np.reshape(place, (rows, 1)),
        "jitter": np.zeros((rows, 2)) if jitter is None else jitter,
        "start": np.tile(start, (rows, 1)),
        "goal": np.tile(goal, (rows, 1)),
    }
    samples = session.run({name: array.astype(np.float32) for name, array in feeds.items()})
    assert samples.shape == (rows, 1, 2)
    return samples[:, 0].astype(np.float64)


def confidence(head: bytes, configurations: np.ndarray) -> np.ndarray:
    feeds = {
        "image": np.zeros((1, 3, 48, 48), np.float32),
        "configurations": configurations.astype(np.float32),
    }
    return opened(head).run(["confidence"], feeds)[0]


@pytest.fixture(scope="module")
def head() -> bytes:
    return walled_head()


@pytest.fixture(scope="module")
def session(head: bytes) -> Ways:
    return Ways(way_graph(head, TWO_LINK.space, LATENT, STRAIGHT))


def test_a_way_leads_from_start_to_goal_through_the_gap(session, head):
    start, goal = np.array([0.2, 2.0]), np.array([2.0, -2.5])
    way = asked(session, start, goal, np.linspace(0.0, 1.0, 2001))
    np.testing.assert_allclose(way[[0, -1]], [start, goal], atol=1e-5)
    steps = np.linalg.norm(difference(way[:-1], way[1:]), axis=1)
    # Evenly spread over the length, without a jump.
    assert steps.max() < 2.0 * np.median(steps)
    assert np.mean(confidence(head, way) > 0.5) > 0.99
    crossing = way[np.argmin(np.abs(way[:, 0] - 1.0))]
    assert abs(crossing[1]) < 0.5 + 0.14


@pytest.mark.parametrize(
    ("start", "goal"), [((0.2, 2.0), (2.0, -2.5)), ((-1.0, -3.0), (-2.0, 3.0)), ((0.0, 0.0), (0.1, 0.1))]
)
def test_a_way_is_as_cheap_as_dijkstras(session, head, start, goal):
    cells = (STRAIGHT.cells,) * 2
    grid = centres(TWO_LINK.space, cells)
    read = np.round(confidence(head, grid) * STRAIGHT.levels) / STRAIGHT.levels
    weights = 1.0 + STRAIGHT.penalty * (1.0 - read.astype(np.float64)).reshape(cells)
    tree = ways_to(TWO_LINK.space, weights, goal)
    way = asked(session, np.array(start), np.array(goal), np.linspace(0.0, 1.0, 4001))
    steps = np.linalg.norm(difference(way[:-1], way[1:]), axis=1)
    cell = (
        np.floor((way - TWO_LINK.space.lower) / spacing(TWO_LINK.space, cells)).astype(int) % STRAIGHT.cells
    )
    cost = np.sum(steps * weights[tuple(cell[:-1].T)])
    best = tree.costs[tuple(((np.array(start) + np.pi) // spacing(TWO_LINK.space, cells)).astype(int))]
    # A step counts the cell that it leaves here and half of both there; the ends lie within their cells.
    assert cost <= 1.1 * best + 0.4


def test_samples_lie_about_the_way_as_widely_as_the_tube(head):
    wide = Ways(way_graph(head, TWO_LINK.space, LATENT, WaySettings(widest_rad=0.2, gap_rad=0.0)))
    ends = np.array([0.2, 2.0]), np.array([2.0, -2.5])
    rng = np.random.default_rng(0)
    place, jitter = rng.random(4000), rng.standard_normal((4000, 2))
    found = asked(wide, *ends, place, jitter)
    narrow = Ways(way_graph(head, TWO_LINK.space, LATENT, STRAIGHT))
    np.testing.assert_allclose(found - asked(narrow, *ends, place), 0.2 * jitter, atol=1e-4)


def test_a_limit_is_not_crossed_and_a_circle_is(head):
    ends = np.array([[-1.0, -2.8], [-1.0, 2.8]])
    place = np.linspace(0.0, 1.0, 501)
    over_the_seam = asked(Ways(way_graph(head, TWO_LINK.space, LATENT, STRAIGHT)), *ends, place)
    assert np.all(np.abs(over_the_seam[:, 1]) > 2.7)
    within = asked(Ways(way_graph(head, LIMITED.space, LATENT, STRAIGHT)), *ends, place)
    assert np.any(np.abs(within[:, 1]) < 0.1)
    assert np.all(np.abs(within[:, 1]) <= 3.0)


def test_rounding_in_the_head_does_not_move_the_way(session):
    other = Ways(way_graph(walled_head(wall_rad=1.0 + 1e-7), TWO_LINK.space, LATENT, STRAIGHT))
    place = np.linspace(0.0, 1.0, 101)
    for start, goal in (((0.2, 2.0), (2.0, -2.5)), ((0.0, 0.0), (-2.5, 1.0))):
        ends = np.array(start), np.array(goal)
        assert np.array_equal(asked(session, *ends, place), asked(other, *ends, place))


def test_a_way_that_needs_more_cells_than_sweeps_still_gives_configurations(head):
    hasty = Ways(way_graph(head, TWO_LINK.space, LATENT, WaySettings(sweeps=3)))
    found = asked(hasty, np.array([0.2, 2.0]), np.array([2.0, -2.5]), np.linspace(0.0, 1.0, 50))
    assert np.isfinite(found).all()


def test_the_graphs_stand_alone_and_are_small(head):
    graph = way_graph(head, TWO_LINK.space, LATENT)
    for model in (graph.model, graph.map):
        onnx.checker.check_model(onnx.load_from_string(model))
    assert len(graph.model) + len(graph.map) < 400_000


def test_the_map_is_what_the_head_says_of_the_cells(head):
    image = {"image": np.zeros((1, 3, 48, 48), np.float32)}
    (seen,) = opened(way_graph(head, TWO_LINK.space, LATENT).map).run(["map"], image)
    np.testing.assert_array_equal(seen, confidence(head, centres(TWO_LINK.space, (48, 48))))


def test_three_joints_are_refused(head):
    with pytest.raises(ConfigError, match="two joints"):
        way_graph(head, THREE_LINK.space, LATENT)


def test_samples_come_in_sweeps_from_the_start_to_the_goal_with_the_gap_between_them(head):
    start, goal = np.array([0.2, 2.0]), np.array([2.0, -2.5])
    plain = Ways(way_graph(head, TWO_LINK.space, LATENT, STRAIGHT))
    whole = asked(plain, start, goal, np.linspace(0.0, 1.0, 2001))
    length = np.linalg.norm(difference(whole[:-1], whole[1:]), axis=1).sum()
    settings = WaySettings(tube_rad=0.0, widening_rad=0.0, gap_rad=length / 7.5)
    swept = Ways(way_graph(head, TWO_LINK.space, LATENT, settings))
    place = np.random.default_rng(0).random(24)
    wanted = (np.arange(24) % 8 + place) / 8
    np.testing.assert_allclose(asked(swept, start, goal, place), asked(plain, start, goal, wanted), atol=1e-4)
    few = asked(swept, start, goal, place[:3])
    np.testing.assert_allclose(few, asked(plain, start, goal, (np.arange(3) + place[:3]) / 3), atol=1e-4)


def test_every_sweep_is_wider_than_the_one_before_up_to_the_widest(head):
    start, goal = np.array([0.2, 2.0]), np.array([2.0, -2.5])
    settings = WaySettings(tube_rad=0.0, widening_rad=0.1, widest_rad=0.25, gap_rad=100.0)
    graph = Ways(way_graph(head, TWO_LINK.space, LATENT, settings))
    place, jitter = np.full(5, 0.4), np.ones((5, 2))
    beside = asked(graph, start, goal, place, jitter) - asked(graph, start, goal, place)
    np.testing.assert_allclose(beside, np.array([[0.0, 0.1, 0.2, 0.25, 0.25]]).T * [[1.0, 1.0]], atol=1e-5)
