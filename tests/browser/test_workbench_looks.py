"""The workbench by keyboard, for screen readers, in the dark, in narrow windows, and from one server."""

import re
from collections.abc import Iterator

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Locator, Page, expect

from tests.browser.workbench import answer_of, bench_server, hash_of, open_bench

pytestmark = [pytest.mark.browser, pytest.mark.e2e, pytest.mark.slow]

SCHEMES = ("light", "dark")
SIZES = {"wide": (1480, 940), "narrow": (390, 844)}
MOST_TABS = 60


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with bench_server(tmp_path_factory.mktemp("bench")) as found:
        yield found


def tab_to(page: Page, wanted: Locator) -> None:
    """Press Tab until an element has the focus."""
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        if wanted.evaluate("(element) => element === document.activeElement"):
            return
    raise AssertionError(f"{wanted} is not reached by Tab")


def test_everything_can_be_done_by_keyboard_alone(page: Page, address: str) -> None:
    open_bench(page, address, hash_of([(2.6, 1.9, 1.0), (0.5, -3.2, 1.0)]))
    second = page.get_by_role("button", name=re.compile("^Disc 2"))
    tab_to(page, second)
    for key in ("ArrowRight", "ArrowUp", "+"):
        with page.expect_response(answer_of("sample")):
            page.keyboard.press(key)
    expect(second).to_have_accessible_name("Disc 2 at x 0.6 m, y -3.1 m, radius 1.05 m")
    expect(second).to_be_focused()
    joint = page.get_by_role("slider", name="Goal, joint 1")
    tab_to(page, joint)
    page.keyboard.press("ArrowRight")
    expect(joint).to_have_attribute("aria-valuetext", "\N{MINUS SIGN}144°")
    start = page.get_by_role("button", name=re.compile("^Start: "))
    tab_to(page, start)
    page.keyboard.press("ArrowDown")
    expect(start).to_have_accessible_name("Start: joint 1 0°, joint 2 12°")
    plan = page.get_by_role("button", name="Plan a path")
    tab_to(page, plan)
    page.keyboard.press("Enter")
    expect(page.locator("#plan-status")).to_contain_text("Checked against the discs: collision-free.")
    page.keyboard.press("Shift+Tab")
    tab_to(page, page.get_by_role("button", name="Copy as curl"))
    page.keyboard.press("Enter")
    expect(page.locator("#take-text")).to_have_value(re.compile("^curl .*/sample "))
    second.focus()
    page.keyboard.press("Delete")
    expect(second).to_have_count(0)
    expect(page.get_by_role("button", name=re.compile("^Disc 1"))).to_be_focused()
    expect(page.locator("#spoken")).to_have_text("Disc 2 removed")


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_axe_finds_nothing_serious(page: Page, address: str, scheme: str, size: str) -> None:
    page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
    page.set_viewport_size(dict(zip(("width", "height"), SIZES[size], strict=True)))  # type: ignore[arg-type]
    open_bench(page, address)
    found = Axe().run(page).response["violations"]
    serious = [
        (one["id"], [node["html"] for node in one["nodes"]])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
    assert serious == []


@pytest.mark.parametrize("size", SIZES)
def test_nothing_is_cut_off_and_nothing_lies_over_something_else(page: Page, address: str, size: str) -> None:
    page.set_viewport_size(dict(zip(("width", "height"), SIZES[size], strict=True)))  # type: ignore[arg-type]
    open_bench(page, address)
    found = page.evaluate(
        """() => {
            const visible = [...document.querySelectorAll("header *, main *")].filter(
                (one) => one instanceof HTMLElement && one.checkVisibility() && !one.closest(".hidden"));
            const kinds = "button, .button, label, a, h1, h2, h3, dt, dd, p, output, select";
            const leaves = visible.filter((one) => one.matches(kinds));
            const name = (one) => `${one.tagName} ${one.id || one.textContent.trim().slice(0, 30)}`;
            const cut = leaves.filter((one) => one.tagName !== "SELECT"
                && one.scrollWidth > one.clientWidth + 1 && getComputedStyle(one).display !== "inline");
            const over = [];
            leaves.forEach((one, at) => leaves.slice(at + 1).forEach((other) => {
                if (one.contains(other) || other.contains(one)) return;
                const [a, b] = [one.getBoundingClientRect(), other.getBoundingClientRect()];
                const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
                const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
                if (wide > 1 && high > 1) over.push(`${name(one)} / ${name(other)}`);
            }));
            return {cut: cut.map(name), over, aside: document.documentElement.scrollWidth - innerWidth};
        }"""
    )
    assert found["cut"] == []
    assert found["over"] == []
    assert found["aside"] <= 0


def test_the_page_asks_this_server_alone_and_its_policy_refuses_it_nothing(page: Page, address: str) -> None:
    addresses: list[str] = []
    errors: list[str] = []
    page.on("request", lambda request: addresses.append(request.url))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    open_bench(page, address, "#ground=prediction")
    page.get_by_role("button", name="Plan a path").click()
    expect(page.locator("#plan-status")).to_contain_text("Checked")
    page.get_by_role("button", name="Copy as Python").click()
    assert len(addresses) > 20
    assert [one for one in addresses if not one.startswith((f"{address}/", "data:image/png", "about:"))] == []
    assert errors == []


def test_a_script_that_is_not_the_pages_own_is_refused(page: Page, address: str) -> None:
    open_bench(page, address)
    page.evaluate(
        """() => {
            const script = document.createElement("script");
            script.textContent = "window.intruder = true";
            document.body.append(script);
        }"""
    )
    assert page.evaluate("() => window.intruder === undefined")


def test_foreign_text_is_shown_as_text(page: Page, address: str) -> None:
    wicked = "<img src=x class=intruder onerror='window.intruder = true'>"
    problem = {"title": wicked, "detail": wicked}
    page.route("**/plan", lambda route: route.fulfill(json=problem, status=422))
    open_bench(page, address)
    page.get_by_role("button", name="Plan a path").click()
    expect(page.get_by_role("alert")).to_contain_text(wicked)
    expect(page.locator(".intruder")).to_have_count(0)
    assert page.evaluate("() => window.intruder === undefined")
    page.unroute("**/plan")
