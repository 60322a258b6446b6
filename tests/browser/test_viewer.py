"""The 3D viewer against the real API, in a real browser."""

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from tests.browser.viewer import open_viewer, plan_in_viewer, viewer_at
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("api"), {}) as api, viewer_at(api) as found:
        yield found


def test_a_scene_is_sampled_planned_and_changed(page: Page, address: str) -> None:
    open_viewer(page, address)
    assert re.search(r"Confidence \d+%", plan_in_viewer(page))
    table = page.locator("table")
    before = table.text_content() or ""
    page.get_by_role("textbox", name="seed").fill("3")
    expect(table).not_to_have_text(before)
    # Another scene has another path.
    expect(page.get_by_text("In the true scene the path is")).to_have_count(0)
