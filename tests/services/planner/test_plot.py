import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from cspace.errors import ConfigError
from cspace.simulator import Split
from cspace.worlds import examples, simulator_of
from cspace.worlds.planar.arm import THREE_LINK, PlanarArm
from services.planner.ompl_planner import solve
from services.planner.plotting import (
    PATH,
    check_figure_path,
    collision_share,
    outcome_title,
    plot_plan,
    plot_workspace,
    save_figure,
    wrapped_segments,
)
from services.planner.settings import PlannerSettings

WORLD = examples()["panda"]


@pytest.fixture
def samples():
    return np.random.default_rng(0).uniform(-3, 3, (50, 2)).astype(np.float32)


def labels(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_solved_problem_shows_all_its_parts(blocked, samples, tmp_path):
    result = solve(blocked, PlannerSettings(), samples, keep_tree=True)
    figure = plot_plan(blocked, result, samples)
    assert len(figure.axes) == 2
    assert {"start", "goal", "learned samples", "search tree", "path"} <= set(labels(figure))
    assert [axes.get_xlabel() for axes in figure.axes] == ["x (m)", r"$\theta_{1}$ (rad)"]
    target = tmp_path / "plan.png"
    save_figure(figure, target)
    with Image.open(target) as picture:
        assert min(picture.size) > 500
        assert len(picture.convert("RGB").getcolors(10**6) or []) > 50


@pytest.mark.slow
def test_an_arm_in_space_is_drawn_from_the_side_with_the_way_of_its_tool():
    problem = simulator_of(WORLD).problem("table", Split.DEMO, 7)
    axes = Figure().subplots()
    plot_workspace(axes, problem, np.stack([problem.start, problem.goal]))
    ends = WORLD.body.joint_positions_m(np.stack([problem.start, problem.goal]))[:, -1]
    (way,) = [line.get_xydata() for line in axes.get_lines() if line.get_color() == PATH]
    np.testing.assert_allclose(way[[0, -1]], ends[:, [0, 2]], atol=1e-9)
    shown = np.concatenate([line.get_xydata() for line in axes.get_lines()])
    assert np.abs(shown).max() < WORLD.body.reach_m


def test_an_unsolved_problem_shows_no_path_and_says_why(disconnected):
    result = solve(disconnected, PlannerSettings(max_iterations=200), keep_tree=True)
    figure = plot_plan(disconnected, result)
    assert {"path", "learned samples"}.isdisjoint(labels(figure))
    assert "not solved" in outcome_title(disconnected, result)
    assert "iteration limit" in figure.get_suptitle()


def test_three_joints_are_drawn_in_two_planes(make_problem, tmp_path):
    problem = make_problem([(0.0, 2.5)], (0.0, 0.0, 0.0), (-3.0, 0.0, 0.0), THREE_LINK)
    result = solve(problem, PlannerSettings(), keep_tree=True)
    figure = plot_plan(problem, result)
    assert [axes.get_title() for axes in figure.axes] == ["workspace", "joints 1 and 2", "joints 2 and 3"]
    save_figure(figure, tmp_path / "plan.svg")
    assert (tmp_path / "plan.svg").stat().st_size > 1000


def test_the_collision_region_of_two_joints_is_exact(blocked):
    share = collision_share(blocked, (0, 1), 64)
    assert set(np.unique(share)) == {0.0, 1.0}
    # theta1 = pi / 2 by columns, theta2 = 0 by rows: the arm points at the disc.
    assert share[32, 48] == 1.0
    assert share[32, 16] == 0.0


def test_a_segment_over_a_seam_is_plotted_at_both_sides_and_a_limited_joint_has_none():
    limited = PlanarArm(joint_limits_rad=((-3.0, 3.0), None)).space
    start, end = np.array([[2.9, 0.0]]), np.array([[-2.9, 0.0]])
    assert np.allclose(wrapped_segments(limited, start, end, (0, 1)), [[[2.9, 0.0], [-2.9, 0.0]]])
    ends = sorted(tuple(line[:, 0]) for line in wrapped_segments(PlanarArm().space, start, end, (0, 1)))
    assert np.allclose(ends, [[2.9 - 2 * np.pi, -2.9], [2.9, 2 * np.pi - 2.9]])


@pytest.mark.parametrize("name", ["plan.gif", "missing/plan.png"])
def test_a_file_that_can_not_become_a_figure_is_named_first(tmp_path, name):
    with pytest.raises(ConfigError, match="figure's"):
        check_figure_path(tmp_path / name)
