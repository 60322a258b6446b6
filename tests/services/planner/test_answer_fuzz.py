import pytest

from tests.services.planner.answer_fuzz import damaged, fuzz
from tests.services.planner.clients import KINDS

kinds = pytest.mark.parametrize("kind", KINDS)


def test_cases_are_the_same_for_the_same_seed() -> None:
    assert damaged(3, 5) == damaged(3, 5) != damaged(3, 6)


@pytest.mark.slow
@kinds
def test_damaged_answers_give_a_sound_batch_or_an_error_of_the_tree(kind: str) -> None:
    found = fuzz(kind, seed=1, count=300)
    assert found.total() == 300
    # Damage that no answer survives, or none at all, would show nothing.
    assert min(found["SampleBatch"], found["SamplerAnswerError"], found["SamplerUnavailableError"]) >= 10


@pytest.mark.slow
@kinds
def test_damaged_answers_give_nothing_else_for_half_a_minute(kind: str) -> None:
    assert fuzz(kind, seed=2, count=None, time_s=30.0).total() >= 300
