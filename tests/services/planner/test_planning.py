from dataclasses import replace

import numpy as np
import pytest

from cspace.errors import SamplerError
from cspace.query import SampleQuery
from cspace.worlds.planar.camera import decode_png
from cspace.worlds.planar.simulator import render
from services.planner.planning import SampleRequest, plan, raised_share
from services.planner.result import PlannerSettings
from tests.fakes.sample_source import FakeSampleSource

SETTINGS = PlannerSettings(seed=3)


def test_the_source_is_asked_once_for_the_picture_of_the_scenario(blocked):
    source = FakeSampleSource()
    found = plan(blocked, source, SETTINGS, SampleRequest(SampleQuery(40, SETTINGS.seed)))
    assert found.result.solved
    assert len(source.requests) == 1
    request = source.requests[0]
    assert np.array_equal(decode_png(request.image_png), render(blocked.scenario))
    assert (request.query.n, request.query.seed, request.query.start) == (40, 3, None)
    assert found.batch is not None
    assert found.unavailable is None


def test_samples_of_another_robot_are_refused_by_name(blocked):
    source = FakeSampleSource(lambda rng, n: rng.uniform(-1, 1, (n, 3)))
    with pytest.raises(SamplerError, match=r"pretrained/0 are for another robot.*2 joints.*3"):
        plan(blocked, source, SETTINGS)


@pytest.mark.parametrize(
    ("novelty", "expected"),
    [(None, 0.3), (0.0, 0.3), (0.95, 0.3), (0.975, 0.65), (1.0, 1.0)],
)
def test_the_uniform_share_rises_with_the_pictures_novelty(novelty, expected):
    assert raised_share(0.3, novelty) == pytest.approx(expected)


def test_a_picture_like_no_other_is_planned_with_uniform_samples_alone(blocked):
    class Alarmed(FakeSampleSource):
        def answer(self, *arguments):
            return replace(super().answer(*arguments), novelty=1.0)

    alarmed = plan(blocked, Alarmed(), SETTINGS)
    assert alarmed.uniform_share == 1.0
    assert (alarmed.result.learned_drawn, alarmed.batch.shortfall) == (0, 0)
    calm = plan(blocked, FakeSampleSource(), SETTINGS)
    assert calm.uniform_share < 1.0
    assert calm.result.learned_drawn > 0


def test_the_ends_are_sent_where_a_path_model_needs_them(blocked):
    source = FakeSampleSource()
    with pytest.raises(SamplerError):
        plan(blocked, source, SETTINGS, SampleRequest(SampleQuery(300, 3), with_ends=True))
    assert source.requests[0].query.start == tuple(blocked.start.tolist())
    assert source.requests[0].query.goal == tuple(blocked.goal.tolist())
