import numpy as np

from cspace.query import SampleQuery
from cspace.worlds.planar.camera import decode_png
from services.planner.sources.samples import PinnedSource
from tests.bundles import picture
from tests.fakes.sample_source import FakeSampleSource


def test_a_pinned_source_is_asked_for_its_model_with_the_picture_and_the_query_as_they_are():
    source, query = FakeSampleSource(), SampleQuery(5, 9, min_confidence=0.0)
    drawn = PinnedSource(source, "pretrained").answer(picture(), query)
    (asked,) = source.requests
    np.testing.assert_array_equal(decode_png(asked.image_png), picture())
    assert (asked.query, asked.model, drawn.samples.shape) == (query, "pretrained", (5, 2))
