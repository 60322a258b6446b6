"""The Grafana dashboard asks for nothing that a real app does not export."""

import json
import re
from typing import Any

from prometheus_client.parser import text_string_to_metric_families

from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.fake_registry import CountingRegistry
from tests.inference_api.server import ROOT

DASHBOARD = json.loads((ROOT / "services" / "monitoring" / "grafana-dashboard.json").read_text())
NAME = re.compile(r"\b(?:cspace|process)_\w+")
SELECTOR = re.compile(r"(\w+)\{([^}]*)\}")
# Prometheus itself adds these to what it scrapes; `le` is a histogram's.
SCRAPED = {"job", "instance", "le"}


def queries() -> list[str]:
    panels = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
    variables = [
        item["query"]["query"] for item in DASHBOARD["templating"]["list"] if item["type"] == "query"
    ]
    return panels + variables


def exported(api: ApiClient) -> dict[str, set[str]]:
    """Labels by the name of each series, after a good and a bad request."""
    api.post("/sample", files={"image": PNG})
    api.post("/sample", files={"image": b"no PNG"})
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(api.get("/metrics").text):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def test_every_metric_of_the_dashboard_is_exported(own_api: ApiClient) -> None:
    asked = {name for query in queries() for name in NAME.findall(query)}
    assert asked <= set(exported(own_api))
    assert len(asked) > 10


def test_every_metric_of_the_project_is_on_the_dashboard(own_api: ApiClient) -> None:
    asked = " ".join(queries())
    names = {name for name in exported(own_api) if name.startswith("cspace_") and "_created" not in name}
    assert {name for name in names if name not in asked} <= {"cspace_acceptance_ratio_bucket"}


def test_every_label_of_the_dashboard_is_one_of_its_metric(own_api: ApiClient) -> None:
    found = exported(own_api)
    for query in queries():
        labels = {label for name in NAME.findall(query) for label in found[name]} | SCRAPED
        groups = {name for group in re.findall(r"by \(([^)]*)\)", query) for name in group.split(", ")}
        selected = {
            pair.split("=")[0].strip() for _, body in SELECTOR.findall(query) for pair in body.split(",")
        }
        assert groups | selected <= labels, query


def test_the_panels_lie_beside_each_other_and_have_ids_and_words() -> None:
    panels: list[dict[str, Any]] = DASHBOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert all(panel["title"] and panel["description"] for panel in panels)
    cells = [
        (column, row)
        for panel in panels
        for column in range(panel["gridPos"]["x"], panel["gridPos"]["x"] + panel["gridPos"]["w"])
        for row in range(panel["gridPos"]["y"], panel["gridPos"]["y"] + panel["gridPos"]["h"])
    ]
    assert len(set(cells)) == len(cells)
    assert max(column for column, _ in cells) < 24


def test_a_name_that_is_not_exported_would_be_found(start_api: StartApi, registry: CountingRegistry) -> None:
    assert "cspace_no_such_metric" not in exported(start_api(registry))
    assert NAME.findall("rate(cspace_no_such_metric[5m])") == ["cspace_no_such_metric"]
