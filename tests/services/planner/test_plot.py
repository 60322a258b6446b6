import numpy as np
import pytest
from PIL import Image

from cspace.worlds.planar.arm import PlanarArm
from services.planner.ompl_planner import solve
from services.planner.plotting import (
    plot_plan,
    save_figure,
    wrapped_segments,
)
from services.planner.result import PlannerSettings


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


def test_a_segment_over_a_seam_is_plotted_at_both_sides_and_a_limited_joint_has_none():
    limited = PlanarArm(joint_limits_rad=((-3.0, 3.0), None)).space
    start, end = np.array([[2.9, 0.0]]), np.array([[-2.9, 0.0]])
    assert np.allclose(wrapped_segments(limited, start, end, (0, 1)), [[[2.9, 0.0], [-2.9, 0.0]]])
    ends = sorted(tuple(line[:, 0]) for line in wrapped_segments(PlanarArm().space, start, end, (0, 1)))
    assert np.allclose(ends, [[2.9 - 2 * np.pi, -2.9], [2.9, 2 * np.pi - 2.9]])
