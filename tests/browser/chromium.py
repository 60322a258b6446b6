"""Chromium as Debian packages it, headless and without any talk of its own."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page, expect, sync_playwright

PROGRAM = shutil.which("chromium") or "/usr/bin/chromium"
WIDTH, HEIGHT = 1480, 940
LIMIT_MS = 60_000
# As root the sandbox can not be set up; the pages are the project's own, on loopback.
OPTIONS = (
    "--no-sandbox",
    "--disable-gpu",
    # The viewer draws with WebGL.
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-sync",
    "--no-first-run",
    "--no-proxy-server",
)

# MLflow's UI: no assistant over the content.
REMEMBERED = """
localStorage.setItem("mlflow.assistant.panelOpen_v1", "false");
localStorage.setItem("mlflow.assistant.fab.autoOpenedOnFirstLoad_v1", "true");
"""


@contextmanager
def browser_page() -> Iterator[Page]:
    """An empty page of a browser that is closed afterwards; requests to other hosts are refused.

    Raises:
        FileNotFoundError: there is no Chromium.
    """
    if not Path(PROGRAM).exists():
        raise FileNotFoundError(f"{PROGRAM} is not there; on Debian: apt install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=PROGRAM, args=list(OPTIONS), headless=True)
        try:
            page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
            page.set_default_timeout(LIMIT_MS)
            # What a test expects to see waits for 5 s alone otherwise, too short beside other work.
            expect.set_options(timeout=LIMIT_MS)
            page.route(lambda url: "//127.0.0.1:" not in url, lambda route: route.abort())
            page.add_init_script(REMEMBERED)
            yield page
        finally:
            browser.close()
