"""What the workbench tells of itself and of models."""

from pathlib import Path

import pytest

from cspace.errors import ConfigError
from inference_api.workbench import routes
from services.registry.promotion import Decision, record_decision
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.workbench.conftest import StartBench

NAME = "cspace-sampler"
# Of the decisions below.
WHEN = "2023-11-14 22:13 UTC"


def decided(version: int, precision: float, *, promoted: bool) -> Decision:
    return Decision(NAME, version, promoted, ("because",), {"precision": precision}, None, 1_700_000_000_000)


def test_a_version_tells_its_last_figures_all_decisions_and_its_page(
    start_bench: StartBench, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    record_decision(registry, decided(1, 0.8, promoted=False))
    record_decision(registry, decided(1, 0.9, promoted=True))
    api = start_bench(registry=registry, mlflow_pages="https://mlflow.example/base")
    version, shipped = api.get("/workbench/models").json()["models"]
    assert version["reference"] == f"{NAME}/1"
    assert version["rows"][0] == ["precision", "0.9"]
    assert version["rows"][-2:] == [[WHEN, "not promoted: because"], [WHEN, "promoted: because"]]
    assert version["link"] == f"https://mlflow.example/base/#/models/{NAME}/versions/1"
    assert shipped["reference"] == "pretrained"
    assert shipped["rows"][0] == ["precision", "0.5"]
    assert shipped["link"] is None


def test_an_entry_that_nobody_can_read_hides_no_version(
    start_bench: StartBench, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    registry.add(bundles["plain"], "champion")
    registry.set_tags(NAME, 1, {"decision.0001": "no JSON"})
    stories = start_bench(registry=registry).get("/workbench/models").json()
    version = stories["models"][0]
    assert (version["reference"], version["link"]) == (f"{NAME}/1", None)
    assert "promoted" not in str(version["rows"])
    assert stories["champions"] == []


def test_who_was_champion_is_told_with_the_reason_the_latest_first(
    start_bench: StartBench, registry: CountingRegistry, bundles: dict[str, Path]
) -> None:
    for _ in range(2):
        registry.add(bundles["plain"])
    moves = ((1, 0, None, True), (2, 1, 1, False), (2, 2, 1, True), (1, 3, 2, True))
    for version, minutes, against, promoted in moves:
        made_ms = 1_700_000_000_000 + 60_000 * minutes
        decision = Decision(NAME, version, promoted, (f"reason {minutes}",), {}, against, made_ms)
        record_decision(registry, decision)
    assert start_bench(registry=registry).get("/workbench/models").json()["champions"] == [
        ["2023-11-14 22:16 UTC", "version 1 against version 2: reason 3"],
        ["2023-11-14 22:15 UTC", "version 2 against version 1: reason 2"],
        ["2023-11-14 22:13 UTC", "version 1: reason 0"],
    ]


def test_the_truth_without_its_packages_stops_the_start_with_the_remedy(
    start_bench: StartBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match=r"pip install \.\[workbench\]"):
        start_bench()
    assert start_bench(truth=False).get("/workbench/about").json()["plans"] is False
