"""Tables of the documents against the code: problem types, metrics, settings."""

import re
import subprocess
import sys

from prometheus_client.parser import text_string_to_metric_families

from inference_api.problem_types import PROBLEMS
from tests.inference_api.answers import PNG
from tests.inference_api.client import ApiClient
from tests.inference_api.server import ROOT


def rows(document: str, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its two first lines."""
    text = (ROOT / "docs" / document).read_text(encoding="utf-8")
    section = re.split(rf"^#+ {heading}$", text, flags=re.MULTILINE)[1]
    table = re.search(r"(?:^\|.*\n)+", section, re.MULTILINE)
    assert table
    lines = table[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_the_table_of_errors_is_that_of_the_code_in_its_order() -> None:
    documented = [(name.strip("`"), int(status)) for name, status, _ in rows("api.md", "Errors")]
    assert documented == [(problem.name, problem.status) for problem in PROBLEMS]


def test_the_table_of_metrics_is_that_of_a_real_app_labels_included(api: ApiClient) -> None:
    api.post("/sample", files={"image": PNG})
    api.get("/nothing")
    exported: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(api.get("/metrics").text):
        if family.name.startswith("cspace_") and not family.name.endswith("_created"):
            name = f"{family.name}_total" if family.type == "counter" else family.name
            exported[name] = {label for sample in family.samples for label in sample.labels} - {"le"}
    documented = {
        name.strip("`"): set(re.findall(r"`(\w+)`", labels))
        for name, labels, _ in rows("operations.md", "Metrics")
    }
    assert documented == exported


def test_the_settings_that_help_names_are_documented() -> None:
    command = [sys.executable, "-m", "inference_api", "--help"]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    text = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
    # Long lines of help are broken at dashes, not at underscores.
    named = set(re.findall(r"\bCSPACE_\w+", process.stdout))
    assert len(named) > 8
    assert {name for name in named if f"| `{name}` |" not in text} == set()
