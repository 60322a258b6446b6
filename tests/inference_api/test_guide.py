"""``/guide``: the documentation site's files, inside the guards, with a policy of their own."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from inference_api.app import create_app
from inference_api.limits import SECURITY_HEADERS
from inference_api.routes.documentation import POLICY
from inference_api.settings import ApiSettings
from tests.inference_api.answers import assert_problem
from tests.inference_api.client import ApiClient, running


@contextmanager
def api_with(folder: Path, site: Path) -> Iterator[ApiClient]:
    settings = ApiSettings(
        registry_uri=None,
        cache_folder=folder / "cache",
        poll_s=3600.0,
        pretrained_folder=folder / "nothing",
        guide_folder=site,
    )
    with running(create_app(settings)) as client:
        yield client


@pytest.fixture
def site(tmp_path: Path) -> Path:
    folder = tmp_path / "site"
    (folder / "results").mkdir(parents=True)
    (folder / "index.html").write_text("<h1>the first page</h1>")
    (folder / "results" / "quality.html").write_text("<h1>quality</h1>")
    (folder / "theme.js").write_text("document.title = 'x'")
    (tmp_path / "secret.txt").write_text("not part of the site")
    return folder


@pytest.fixture
def api(tmp_path: Path, site: Path) -> Iterator[ApiClient]:
    with api_with(tmp_path, site) as client:
        yield client


def test_the_guide_is_its_first_page_and_every_file_below(api: ApiClient) -> None:
    page = api.get("/guide")
    assert (page.status_code, page.headers["location"]) == (307, "guide/")
    assert api.get("/guide/").text == "<h1>the first page</h1>"
    assert api.get("/guide/results/quality.html").text == "<h1>quality</h1>"
    assert api.get("/guide/theme.js").headers["content-type"].startswith("text/javascript")


def test_pages_of_the_guide_run_scripts_of_the_server_and_no_others(api: ApiClient) -> None:
    answer = api.get("/guide/")
    others = {name: value for name, value in SECURITY_HEADERS.items() if name != "Content-Security-Policy"}
    assert {name: answer.headers[name] for name in others} == others
    given = dict(part.split(" ", 1) for part in answer.headers["content-security-policy"].split("; "))
    assert given["default-src"] == "'none'"
    assert given["script-src"] == "'self'"
    assert answer.headers["content-security-policy"] == POLICY


def test_a_page_that_the_guide_does_not_have_is_a_problem(api: ApiClient) -> None:
    problem = assert_problem(api.get("/guide/nothing.html"), 404, "not-found")
    assert "remedy" not in problem
    assert_problem(api.post("/guide/"), 405, "method-not-allowed")


def test_no_path_leads_out_of_the_guide(api: ApiClient) -> None:
    for path in ("../secret.txt", "%2e%2e/secret.txt", "..%2fsecret.txt", "results/../../secret.txt"):
        assert "not part of the site" not in api.get(f"/guide/{path}").text


def test_a_server_without_a_built_guide_says_how_to_build_it(tmp_path: Path) -> None:
    with api_with(tmp_path, tmp_path / "nothing") as client:
        for path in ("/guide/", "/guide/api.html"):
            problem = assert_problem(client.get(path), 404, "not-found")
            assert problem["detail"].startswith("the guide is not built here")
            assert "make docs" in problem["remedy"]
            assert str(tmp_path) not in str(problem)


def test_a_guide_that_is_built_while_the_server_runs_is_served(tmp_path: Path, site: Path) -> None:
    later = tmp_path / "later"
    with api_with(tmp_path, later) as client:
        assert client.get("/guide/").status_code == 404
        site.rename(later)
        assert client.get("/guide/").status_code == 200


def test_the_guide_is_counted_under_one_name(api: ApiClient) -> None:
    api.get("/guide/results/quality.html")
    counted = [line for line in api.get("/metrics").text.splitlines() if 'route="/guide' in line]
    assert counted
    assert all('route="/guide"' in line for line in counted)
