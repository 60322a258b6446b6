"""A query is held against its bundle once, whoever does it first."""

from dataclasses import replace

import pytest

from cspace.bundle import Bundle
from cspace.bundle.request import FittedQuery, fitted
from cspace.query import SampleQuery
from tests.bundles import picture, write_tiny_bundle


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    return Bundle.load(write_tiny_bundle(tmp_path_factory.mktemp("request") / "bundle", validity=True))


def test_a_query_that_fits_is_not_judged_again_nor_is_it_with_another_seed(bundle: Bundle) -> None:
    query = fitted(SampleQuery(5, 1, robot=bundle.robot), bundle.spec, has_validity=True)
    assert query.min_confidence == (bundle.spec.confidence_threshold or 0.0)
    other = replace(query, seed=2)
    assert isinstance(other, FittedQuery)
    assert fitted(other, bundle.spec, has_validity=True) is other


def test_a_fitted_query_gives_the_samples_of_the_query_itself(bundle: Bundle) -> None:
    query = SampleQuery(50, 3, min_confidence=0.5, robot=bundle.robot)
    fits = fitted(query, bundle.spec, has_validity=True)
    one, other = (bundle.answer(picture(), asked) for asked in (query, fits))
    assert one.samples.tobytes() == other.samples.tobytes()
