"""The pictures of single scenarios: which are shown and what is marked on them."""

import numpy as np
import pytest

from cspace.simulator import Split
from cspace.worlds.planar.arm import THREE_LINK, TWO_LINK, PlanarArm
from cspace.worlds.planar.camera import Camera
from cspace.worlds.planar.world import PlanarWorld
from services.evaluator.report import MISSED_COLOUR, SHOWN_SAMPLES, gallery
from services.evaluator.scenes import Scene, Stage
from tests.fakes.sample_source import FakeSampleSource
from tests.fakes.uniform_sampler import UniformSampler

STAGE = Stage(PlanarWorld(TWO_LINK, Camera()), Split.TEST, 0)


def marked(axes, colour):
    """How many points of a colour a panel holds."""
    from matplotlib.colors import to_rgba

    return sum(
        len(points.get_offsets())
        for points in axes.collections
        if np.allclose(points.get_facecolor()[:1], to_rgba(colour))
    )


@pytest.mark.parametrize("robot", [PlanarArm((2.5,)), TWO_LINK, THREE_LINK])
def test_the_gallery_has_three_panels_a_scenario(robot, tmp_path):
    stage = Stage(PlanarWorld(robot, Camera()), Split.TEST, 0)
    figure = gallery([Scene(stage, 0), Scene(stage, 1)], UniformSampler(robot.space), "two scenarios")
    figure.savefig(tmp_path / "gallery.png")
    assert len(figure.axes) == 6
    assert (tmp_path / "gallery.png").stat().st_size > 10_000
    assert "free" in figure.axes[2].get_title()


def test_free_configurations_that_no_sample_is_near_are_marked():
    scene = Scene(STAGE, 0)
    collapsed = FakeSampleSource(lambda rng, n: np.tile(scene.free(1, scene.rng(0)), (n, 1)))
    panel = gallery([scene], collapsed, "collapsed").axes[2]
    assert "100.0% free" in panel.get_title()
    assert 0.95 * SHOWN_SAMPLES < marked(panel, MISSED_COLOUR) < SHOWN_SAMPLES
