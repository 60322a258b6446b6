import pytest

from tests.services.planner.answer_fuzz import fuzz
from tests.services.planner.clients import KINDS


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_answers_give_a_sound_batch_or_an_error_of_the_tree(kind: str) -> None:
    found = fuzz(kind, seed=1, time_s=30.0)
    assert found.total() >= 300
    # Damage that no answer survives, or none at all, would show nothing.
    assert min(found["SampleBatch"], found["SamplerAnswerError"], found["SamplerUnavailableError"]) >= 10
