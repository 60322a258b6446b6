"""Tasks that are cancelled: those that have not ended, for Ray may end the process over one that has."""

import pytest

from services.evaluator import cluster


def test_what_has_ended_is_not_cancelled(monkeypatch: pytest.MonkeyPatch) -> None:
    cancelled: list[str] = []

    def wait(references: list[str], *, num_returns: int, timeout: float) -> tuple[list[str], list[str]]:
        assert (num_returns, timeout) == (len(references), 0)
        return references[::2], references[1::2]

    monkeypatch.setattr(cluster.ray, "wait", wait)
    monkeypatch.setattr(cluster.ray, "cancel", cancelled.append)
    cluster.cancel(["ended", "running", "over", "waiting"])
    assert cancelled == ["running", "waiting"]
    cluster.cancel([])
    assert cancelled == ["running", "waiting"]
