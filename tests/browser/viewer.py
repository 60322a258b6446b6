"""The 3D viewer in a browser."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Page, expect


@contextmanager
def viewer_at(api: str, *options: str) -> Iterator[str]:
    """Run ``python -m services.planner.viewer`` on an API; yields its address."""
    command = [sys.executable, "-m", "services.planner.viewer", f"--api={api}", "--port=0", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=dict(os.environ)) as process:
        assert process.stdout is not None
        try:
            address = next(line.strip() for line in process.stdout if line.startswith("http://"))
            yield address
        finally:
            process.terminate()
            process.wait(timeout=20)


def open_viewer(page: Page, address: str) -> None:
    """Open the page; returns once it has asked for samples."""
    page.goto(address)
    # Chromium without a GPU draws in software, which viser says over the scene.
    page.get_by_role("alert").get_by_role("button").click()
    expect(page.get_by_text("confidence of the samples")).to_be_visible(timeout=90_000)


def plan_in_viewer(page: Page) -> str:
    """Press the button; returns the verdict."""
    page.get_by_role("button", name="Plan a path").click()
    verdict = page.get_by_text("In the true scene the path is")
    expect(verdict).to_be_visible()
    return verdict.inner_text()
