"""What may happen between the parts of a run."""

from pathlib import Path

import pytest

from cspace.bundle import Bundle
from cspace.bundle.runtime import CHUNK_ROWS
from tests.bundles import picture


class StopError(Exception):
    pass


def test_between_is_called_between_the_parts_of_generator_and_head(folder: Path) -> None:
    bundle, calls = Bundle.load(folder), []
    bundle.sample(picture(), CHUNK_ROWS, 1, check_cancelled=lambda: calls.append(1))
    assert calls == []
    n = 3 * CHUNK_ROWS + 1
    found = bundle.sample(picture(), n, 1, check_cancelled=lambda: calls.append(1))
    assert len(calls) == 6
    assert found.samples.tobytes() == bundle.sample(picture(), n, 1).samples.tobytes()
    # Of a request that is filtered, between its turns.
    found = bundle.sample(picture(), 100, 1, min_confidence=0.7, check_cancelled=lambda: calls.append(1))
    assert len(calls) > 6
    assert found.samples.tobytes() == bundle.sample(picture(), 100, 1, min_confidence=0.7).samples.tobytes()


@pytest.mark.parametrize("request_", [{"n": CHUNK_ROWS + 1}, {"n": 100, "min_confidence": 0.99}])
def test_what_between_raises_passes_through(folder: Path, request_: dict[str, float]) -> None:
    def stop() -> None:
        raise StopError

    with pytest.raises(StopError):
        Bundle.load(folder).sample(picture(), seed=1, check_cancelled=stop, **request_)  # type: ignore[arg-type]
