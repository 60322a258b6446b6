"""The documentation page of the inference API works under its own content security policy."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import ConsoleMessage, Page

from tests.bundles import write_tiny_bundle
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e]


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    bundle = write_tiny_bundle(tmp_path / "bundle")
    with api_server(tmp_path, {"CSPACE_PRETRAINED_MODEL": str(bundle)}) as found:
        yield found


def test_the_page_shows_every_operation_sends_a_request_and_is_refused_nothing(
    page: Page, address: str
) -> None:
    errors: list[str] = []

    def keep(message: ConsoleMessage) -> None:
        if message.type == "error":
            errors.append(message.text)

    page.on("console", keep)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{address}/docs")
    page.wait_for_selector(".opblock")
    paths = page.eval_on_selector_all(".opblock-summary-path", "found => found.map(one => one.dataset.path)")
    assert {"/sample", "/models", "/metrics"} <= set(paths)
    block = page.locator(".opblock", has=page.locator('[data-path="/health/live"]'))
    block.locator(".opblock-summary-control").click()
    block.get_by_role("button", name="Try it out").click()
    block.get_by_role("button", name="Execute").click()
    block.locator(".live-responses-table .response-col_status").get_by_text("200").wait_for()
    assert errors == []


def test_a_script_that_is_not_the_pages_own_is_refused(page: Page, address: str) -> None:
    page.goto(f"{address}/docs")
    page.evaluate(
        """() => {
            const script = document.createElement("script");
            script.textContent = "window.intruder = true";
            document.body.append(script);
        }"""
    )
    assert page.evaluate("() => window.intruder === undefined")
