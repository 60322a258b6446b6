"""Scene files that are opened in the workbench or dropped on it."""

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import FilePayload, Page, expect

from tests.browser.workbench import discs_in_address, hash_of, is_page, open_bench, settle
from tests.inference_api.server import api_server

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow]

TEXT = """\
robot: {link_lengths_m: [2.0, 2.0]}
obstacles:
  - {x_m: 1.5, y_m: 2, radius_m: 0.4}
  - {x_m: -1.5, y_m: 2.5}
start: [0, 0.4]
goal: [-1.8, -0.5]
"""
VALUES = {
    "robot": {"link_lengths_m": [2.0, 2.0]},
    "obstacles": [{"x_m": 1.5, "y_m": 2, "radius_m": 0.4}, {"x_m": -1.5, "y_m": 2.5}],
    "start": [0, 0.4],
    "goal": [-1.8, -0.5],
}
DISCS = [(1.5, 2.0, 0.4), (-1.5, 2.5, 1.0)]
DROP = """([name, text]) => {
    const data = new DataTransfer();
    data.items.add(new File([text], name));
    const options = {dataTransfer: data, bubbles: true, cancelable: true};
    return document.querySelector("#scene").dispatchEvent(new DragEvent("drop", options));
}"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with api_server(tmp_path_factory.mktemp("bench"), {"CSPACE_API_WORKBENCH": "1"}) as found:
        body = {"discs": [], "path": [[0, 0], [1, 1]]}
        httpx.post(f"{found}/workbench/truth", json=body, timeout=60).raise_for_status()
        yield found


def file_of(name: str, text: str) -> FilePayload:
    return {"name": name, "mimeType": "", "buffer": text.encode()}


def expect_shown(page: Page) -> None:
    """Wait until the scene of the file is in the page's address."""
    page.wait_for_url(lambda url: "start=0,0.4&goal=-1.8,-0.5" in url)
    assert discs_in_address(page) == DISCS
    expect(page.get_by_role("alert")).to_be_hidden()
    settle(page)


@pytest.mark.parametrize(("name", "text"), [("a.yaml", TEXT), ("a.json", json.dumps(VALUES))], ids=str)
def test_a_scene_file_that_is_opened_is_shown_with_its_ends(
    page: Page, address: str, name: str, text: str
) -> None:
    open_bench(page, address)
    with page.expect_response(is_page("sample")):
        page.locator("#open").set_input_files(file_of(name, text))
    expect_shown(page)


def test_a_scene_file_that_is_dropped_takes_the_place_of_a_picture_too(page: Page, address: str) -> None:
    open_bench(page, address, "#picture=iVBORw0KGgo")
    expect(page.get_by_role("button", name="Back to discs")).to_be_visible()
    assert page.evaluate(DROP, ["a.yml", TEXT]) is False
    expect_shown(page)
    expect(page.get_by_role("button", name="Back to discs")).to_be_hidden()


def test_what_does_not_fit_is_told_with_its_line_and_changes_nothing(page: Page, address: str) -> None:
    open_bench(page, address, hash_of([(3.0, 3.0, 0.5)]))
    page.evaluate(DROP, ["a.yaml", TEXT.replace("0.4}", "-1}")])
    expect(page.get_by_role("alert")).to_contain_text(
        "the file:3: the file: obstacles.0.radius_m does not fit"
    )
    page.evaluate(DROP, ["a.yaml", TEXT.replace("[2.0, 2.0]", "[2.0, 1.5]")])
    expect(page.get_by_role("alert")).to_contain_text("No model for the file")
    expect(page.get_by_role("alert")).to_contain_text("1.5")
    assert discs_in_address(page) == [(3.0, 3.0, 0.5)]
    page.evaluate(DROP, ["a.yaml", TEXT])
    expect_shown(page)


def test_without_the_truth_the_page_reads_json_itself_and_says_so_of_yaml(page: Page, tmp_path: Path) -> None:
    with api_server(tmp_path, {}) as bare:
        open_bench(page, bare, hash_of([]))
        for text in (TEXT, json.dumps({**VALUES, "obstacles": [{"x_m": "1"}]}), json.dumps([])):
            page.evaluate(DROP, ["a.json", text])
            expect(page.get_by_role("alert")).to_contain_text("Not a scene file")
            page.get_by_role("button", name="Dismiss").click()
        page.locator("#open").set_input_files(file_of("a.json", json.dumps(VALUES)))
        expect_shown(page)
        page.goto("about:blank")
