"""The site, built as `make docs` builds it: no warning, no script in a page, the search finds pages."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page

from tests.browser.chromium import browser_page
from tests.bundles import write_tiny_bundle
from tests.docs.blocks import ROOT
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

LIMIT_S = 500.0


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    recipe = re.search(r"^SITE := (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert recipe
    options = recipe[1].partition("-m sphinx ")[2].partition(" -d ")[0].split()
    assert {"-W", "-E"} <= set(options)
    command = [sys.executable, "-m", "sphinx", *options, "-d", str(folder / "state"), "-b", "html", "docs"]
    outcome = subprocess.run(
        [*command, str(folder / "html")],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
        timeout=LIMIT_S,
    )
    assert (outcome.returncode, outcome.stderr) == (0, "")
    return folder / "html"


def test_the_site_is_built_without_a_warning_and_has_every_page(site: Path) -> None:
    pages = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    assert [str(page) for page in pages if not (site / page).is_file()] == []
    made = ("openapi", "commands", "configuration", "python", "readme", "changelog")
    assert [name for name in made if not (site / "site" / f"{name}.html").is_file()] == []
    drawn = list((site / "_images").glob("sphx_glr_plot_*.png"))
    assert len({path.name.split("_001")[0] for path in drawn if "thumb" not in path.name}) == 4


def test_no_page_has_a_script_in_it_or_asks_another_server(site: Path) -> None:
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        inline = [
            body for body in re.findall(r"<script[^>]*>(.*?)</script>", text, re.DOTALL) if body.strip()
        ]
        assert (path.name, inline) == (path.name, [])
        assert re.search(r"\son[a-z]+=\"", re.sub(r"<pre>.*?</pre>", "", text, flags=re.DOTALL)) is None
        assert re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=\"(?:https?:)?//[^\"]*\"", text) == []


def test_links_within_the_site_lead_to_files_and_places(site: Path) -> None:
    missing = []
    places: dict[Path, set[str]] = {}
    for path in site.rglob("*.html"):
        for target in re.findall(r"<a [^>]*href=\"([^\"]+)\"", path.read_text(encoding="utf-8")):
            name, _, anchor = target.partition("#")
            if re.match(r"[a-z]+:", target):
                continue
            file = (path.parent / name.partition("?")[0]).resolve() if name else path
            if not file.is_file():
                missing.append((path.name, target))
            elif anchor and file.suffix == ".html":
                if file not in places:
                    places[file] = set(re.findall(r"\bid=\"([^\"]+)\"", file.read_text(encoding="utf-8")))
                if anchor not in places[file]:
                    missing.append((path.name, target))
    assert missing == []


@pytest.fixture(scope="module")
def guide(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of the site as a real API serves it."""
    folder = tmp_path_factory.mktemp("api")
    bundle = write_tiny_bundle(folder / "bundle")
    settings = {"CSPACE_PRETRAINED_MODEL": str(bundle), "CSPACE_API_GUIDE": str(site)}
    with api_server(folder, settings) as address:
        yield f"{address}/guide/"


@pytest.fixture
def page() -> Iterator[Page]:
    with browser_page() as opened:
        yield opened


@pytest.mark.browser
@pytest.mark.e2e
def test_the_guide_works_in_a_browser_under_the_servers_policy(guide: str, page: Page) -> None:
    refused: list[str] = []
    page.on("console", lambda message: refused.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: refused.append(str(error)))
    page.goto(guide)
    page.get_by_role("link", name="Getting started").first.click()
    page.get_by_role("heading", name="Getting started").wait_for()
    before = page.evaluate("document.body.dataset.theme")
    page.locator("button.theme-toggle:visible").click()
    chosen = page.evaluate("document.body.dataset.theme")
    assert chosen != before
    page.goto(f"{guide}method.html")
    assert page.evaluate("document.body.dataset.theme") == chosen
    assert refused == []


@pytest.mark.browser
@pytest.mark.e2e
@pytest.mark.parametrize(
    ("term", "found"),
    [
        ("bottleneck", "method"),
        ("k-NN recall", "method"),
        ("noise floor", "method"),
        ("validity.points_per_link", "configuration"),
    ],
)
def test_a_search_in_a_browser_finds_the_page(guide: str, page: Page, term: str, found: str) -> None:
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(guide)
    page.get_by_role("searchbox").or_(page.get_by_placeholder("Search")).first.fill(term)
    page.keyboard.press("Enter")
    page.locator(f"#search-results li a[href*='{found}.html']").first.wait_for()
    page.get_by_text("Search finished, found").wait_for()
    assert errors == []


@pytest.mark.browser
@pytest.mark.e2e
def test_no_page_is_wider_than_a_phone(guide: str, page: Page, site: Path) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    wide = []
    for path in sorted(site.rglob("*.html")):
        page.goto(f"{guide}{path.relative_to(site)}")
        if page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth"):
            wide.append(str(path.relative_to(site)))
    assert wide == []
