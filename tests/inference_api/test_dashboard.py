"""The Grafana dashboard asks for nothing that a real app does not export, and shows all of it."""

import json
import re

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient
from tests.inference_api.server import ROOT

DASHBOARD = json.loads((ROOT / "services" / "monitoring" / "grafana-dashboard.json").read_text())
PANELS = [target["expr"] for panel in DASHBOARD["panels"] for target in panel["targets"]]
VARIABLES = [one["query"]["query"] for one in DASHBOARD["templating"]["list"] if one["type"] == "query"]
QUERIES = PANELS + VARIABLES
NAME = re.compile(r"\b(?:cspace|process)_\w+")
SELECTOR = re.compile(r"(\w+)\{([^}]*)\}")
# Prometheus itself adds these to what it scrapes; `le` is a histogram's.
SCRAPED = {"job", "instance", "le"}


@pytest.fixture
def exported(api: ApiClient) -> dict[str, set[str]]:
    """Labels by the name of each series, after a good and a bad request."""
    api.post("/sample", files={"image": PNG})
    api.post("/sample", files={"image": b"no PNG"})
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(api.get("/metrics").text):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def test_every_metric_and_label_of_the_dashboard_is_exported(exported: dict[str, set[str]]) -> None:
    queried = {name for query in QUERIES for name in NAME.findall(query)}
    assert queried <= set(exported)
    assert len(queried) > 10
    for query in QUERIES:
        labels = {label for name in NAME.findall(query) for label in exported[name]} | SCRAPED
        groups = {name for group in re.findall(r"by \(([^)]*)\)", query) for name in group.split(", ")}
        selected = {
            pair.split("=")[0].strip() for _, body in SELECTOR.findall(query) for pair in body.split(",")
        }
        assert groups | selected <= labels, query


def test_every_metric_of_the_project_is_on_the_dashboard(exported: dict[str, set[str]]) -> None:
    queried = " ".join(QUERIES)
    names = {name for name in exported if name.startswith("cspace_") and "_created" not in name}
    assert not {name for name in names if name not in queried}
