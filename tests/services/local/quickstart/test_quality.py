"""The new version and the shipped one side by side, as a client of the API sees them."""

from contextlib import contextmanager
from dataclasses import replace

import pytest

from cspace.worlds import default_world, robot_digest
from services.local import quickstart
from services.local.jobs import EvaluationResult, TrainingResult
from services.local.quickstart import TOURS
from services.planner.samples import SampleSource
from tests.fakes.uniform_sampler import UniformSampler

MODELS = ("cspace-sampler/1", "pretrained")
TOUR = replace(TOURS["planar"], scenarios=2)


class Api(SampleSource):
    """Answers with uniform samples; of the model ``short`` too few where it filters."""

    def __init__(self):
        self.calls, self.short = [], None
        self.source = UniformSampler(default_world().space)

    def answer(self, picture, query, model=None):
        self.calls.append((model, query.min_confidence, query.seed))
        found = self.source.answer(picture, query)
        if (model, query.min_confidence) == (self.short, None):
            return replace(found, samples=found.samples[:-1])
        return found


@pytest.fixture
def api(monkeypatch):
    fake = Api()

    @contextmanager
    def client(url, robot):
        assert robot == robot_digest(default_world())
        yield fake

    monkeypatch.setattr(quickstart, "SamplingClient", client)
    monkeypatch.setattr(quickstart, "SAMPLES", 60)
    return fake


def test_both_models_are_asked_on_the_same_scenarios_with_the_same_seeds_with_and_without_filter(api):
    found = quickstart.served_quality("http://api", MODELS, TOUR)
    assert list(found) == list(MODELS)
    assert [call[:2] for call in api.calls] == 2 * [(m, least) for m in MODELS for least in (0.0, None)]
    assert [len({seed for _, _, seed in api.calls[first : first + 4]}) for first in (0, 4)] == [1, 1]
    # Uniform samples under the same seeds: all equal, and so comparable.
    assert len({one["sampler", "precision"].estimate for one in found.values()}) == 1
    assert len({one["confident", "precision"].estimate for one in found.values()}) == 1


def test_the_summary_shows_both_models_side_by_side_and_why_the_shipped_one_was_left_out(api):
    api.short = MODELS[0]
    found = quickstart.served_quality("http://api", MODELS, TOUR)
    note = "not compared with the shipped model, as requested"
    text = quickstart.summary(
        TrainingResult(run_id="run", model="cspace-sampler", version=1, digest="digest"),
        EvaluationResult(run_id="run", version=1, promoted=True, reasons=(note,), metrics={}),
        found,
        TOUR.scenarios,
        (),
        1.0,
    )
    assert note in text
    table = [line.split("  ")[0] for line in text.splitlines()]
    rows = ["cspace-sampler/1", "pretrained (shipped)", "pretrained (shipped), as served", "uniform"]
    assert [row for row in table if row in (*rows, "cspace-sampler/1, as served")] == rows


def test_every_tour_asks_for_the_gate_without_the_shipped_model():
    assert all("--model {model} --without-shipped" in tour.evaluate for tour in TOURS.values())
