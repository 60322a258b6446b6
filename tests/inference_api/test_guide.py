"""``/docs`` and ``/guide``: files of the server alone, with policies of their own; documented tables."""

import re
from itertools import chain
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from inference_api.problems import PROBLEMS
from inference_api.settings import ApiSettings
from tests.inference_api.answers import PNG, assert_problem
from tests.inference_api.client import ApiClient
from tests.inference_api.conftest import StartApi
from tests.inference_api.server import ROOT


@pytest.fixture
def site(tmp_path: Path) -> Path:
    folder = tmp_path / "site"
    (folder / "results").mkdir(parents=True)
    (folder / "index.html").write_text("<h1>the first page</h1>")
    (folder / "results" / "quality.html").write_text("<h1>quality</h1>")
    (tmp_path / "secret.txt").write_text("not part of the site")
    return folder


def test_the_documentation_needs_nothing_from_elsewhere(api: ApiClient) -> None:
    page = api.get("/docs")
    assert not re.findall(r"(?:https?:)?//[a-z]", re.sub(r"//#.*|// .*", "", page.text))
    addresses = re.findall(r'(?:src|href)="([^"]+)"', page.text)
    assert len(addresses) == 3
    for address in addresses:
        assert len(api.get(f"/{address}").content) > 1000
    assert "url: 'openapi.json'" in page.text
    policy = dict(part.split(" ", 1) for part in page.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"].startswith("'self' 'sha256-")


def test_the_guide_is_its_first_page_and_every_file_below(start_api: StartApi, site: Path) -> None:
    api = start_api(None, api_guide=site)
    page = api.get("/guide")
    assert (page.status_code, page.headers["location"]) == (307, "guide/")
    assert api.get("/guide/").text == "<h1>the first page</h1>"
    answer = api.get("/guide/results/quality.html")
    assert answer.text == "<h1>quality</h1>"
    assert "script-src 'self';" in answer.headers["content-security-policy"]
    assert "remedy" not in assert_problem(api.get("/guide/nothing.html"), 404, "not-found")
    for path in ("../secret.txt", "%2e%2e/secret.txt", "..%2fsecret.txt", "results/../../secret.txt"):
        assert "not part of the site" not in api.get(f"/guide/{path}").text
    counted = [line for line in api.get("/metrics").text.splitlines() if 'route="/guide' in line]
    assert counted
    assert all('route="/guide"' in line for line in counted)


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


def test_the_table_of_metrics_is_that_of_a_real_app(api: ApiClient) -> None:
    api.post("/sample", files={"image": PNG})
    exported = {
        f"{family.name}_total" if family.type == "counter" else family.name
        for family in text_string_to_metric_families(api.get("/metrics").text)
        if family.name.startswith("cspace_") and not family.name.endswith("_created")
    }
    documented = [re.findall(r"`(\w+)`", names) for names, _ in rows("operations.md", "Metrics")]
    assert set(chain.from_iterable(documented)) == exported


def test_documented_settings_of_the_api_are_those_of_the_code() -> None:
    text = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"\| `CSPACE_(API_\w+)` \|", text)) - {"API_PORT", "API_URL"}
    assert len(documented) > 6
    assert {name.lower() for name in documented} <= set(ApiSettings.model_fields)
