"""Pictures of the workbench for the documents.

python -m tests.browser.workbench_pictures --out docs/images
"""

import argparse
import io
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect

from tests.browser.chromium import browser_page
from tests.browser.viewer import open_viewer, plan_in_viewer, viewer_at
from tests.browser.workbench import open_bench
from tests.inference_api.server import api_server

# Colour scheme, width and height of the window in px, and what is opened.
PICTURES = {
    "workbench-light": ("light", 1480, 940, ""),
    "workbench-dark": ("dark", 1480, 940, ""),
    "workbench-phone": ("light", 390, 844, ""),
    "workbench-trees": ("light", 1480, 940, "#search=RRT,shown,2000"),
}
COLOURS = 256


def main() -> int:
    """Parse, start a server on the shipped model, plan, take the pictures."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.browser.workbench_pictures", description="Take pictures of the workbench."
    )
    parser.add_argument("--out", type=Path, required=True, help="the folder")
    options = parser.parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        api_server(Path(folder), {"CSPACE_API_WORKBENCH": "1"}) as address,
        browser_page() as page,
    ):
        for name in PICTURES:
            _write(_taken(page, address, name), options.out / f"{name}.png")
        with viewer_at(address) as shown:
            page.set_viewport_size({"width": 1480, "height": 940})
            open_viewer(page, shown)
            plan_in_viewer(page)
            _write(page.screenshot(), options.out / "viewer.png")
        page.goto("about:blank")
    return 0


def _taken(page: Page, address: str, name: str) -> bytes:
    """A planned way, a little less than half of it gone."""
    scheme, width, height, fragment = PICTURES[name]
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")  # type: ignore[arg-type]
    page.set_viewport_size({"width": width, "height": height})
    open_bench(page, address, fragment)
    page.get_by_role("button", name="Plan a path").click()
    expect(page.locator("#plan-status")).to_contain_text("Checked")
    page.get_by_role("slider", name="Along the path").evaluate(
        "(slider) => { slider.value = 450; slider.dispatchEvent(new Event('input')); slider.blur(); }"
    )
    return page.screenshot(full_page=True, animations="disabled")


def _write(taken: bytes, path: Path) -> None:
    """Few colours, for they are few; they are moved to where they are needed, or a dark plane gets blocks."""
    with Image.open(io.BytesIO(taken)) as picture:
        picture.convert("RGB").quantize(
            COLOURS, Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE
        ).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
