"""Pictures of the workbench for the documents.

python -m tests.browser.workbench_pictures --out docs/images
"""

import argparse
import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps
from playwright.sync_api import Page, expect

from cspace_client import SamplingClient
from services.planner.viewer import FOCUS_M, Viewer
from tests.browser.chromium import browser_page
from tests.browser.viewer import open_viewer, plan_in_viewer, viewer_at
from tests.browser.workbench import open_bench, plan
from tests.inference_api.server import api_server

SCHEMES = ("light", "dark")
WINDOW_PX = {"width": 1480, "height": 940}
COLOURS = 256
# The animation's size and number of frames, the width of the viewer's controls, the depth picture's width.
ANIMATED_PX, FRAMES, PANEL_PX, INSET_PX = (800, 520), 24, 340, 200
# Until a browser that draws in software shows a change.
FRAME_MS = 3000


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
        page.set_viewport_size(WINDOW_PX)  # type: ignore[arg-type]
        for scheme in SCHEMES:
            (options.out / f"workbench-{scheme}.png").write_bytes(_taken(page, address, scheme))
        with viewer_at(address) as shown:
            open_viewer(page, shown)
            plan_in_viewer(page)
            _write(page.screenshot(), options.out / "viewer.png")
        page.goto("about:blank")
        with SamplingClient(address) as api:
            _animate(page, Viewer(api, "pretrained-panda", "127.0.0.1", 0), options.out)
        page.goto("about:blank")
    return 0


def _animate(page: Page, viewer: Viewer, folder: Path) -> None:
    """``plan.webp``: what one camera sees, what the model expects beyond it, and the arm along a path."""
    viewer.state.change(cameras=viewer.state.scene.cameras[:1])
    viewer.scene.expected.value = True
    viewer.scene.show()
    viewer.plan.show()
    # As the documents say.
    if "collision-free" not in viewer.plan.verdict.content:
        raise SystemExit(viewer.plan.verdict.content)
    viewer.server.scene.remove_by_name("/scene/samples")
    page.set_viewport_size({"width": ANIMATED_PX[0] + PANEL_PX, "height": ANIMATED_PX[1]})
    page.goto(viewer.address)
    page.get_by_role("alert").get_by_role("button").click()
    expect(page.get_by_text("confidence of the samples")).to_be_visible()
    (client,) = viewer.server.get_clients().values()
    (depth,) = viewer.state.scene.view().pictures
    frames = []
    for at in range(FRAMES):
        share = at / (FRAMES - 1)
        turn = np.radians(-50.0 + 30.0 * share)
        client.camera.position = np.array(FOCUS_M) + 1.3 * np.array([np.cos(turn), np.sin(turn), 0.45])
        client.camera.look_at = np.array(FOCUS_M) - (0.1, 0.0, 0.15)
        viewer.plan.along.value = share
        page.wait_for_timeout(FRAME_MS)
        with Image.open(io.BytesIO(page.screenshot(animations="disabled"))) as taken:
            frames.append(_with_depth(taken.convert("RGB").crop((0, 0, *ANIMATED_PX)), depth))
    # The first and the last stand still for a moment.
    frames = [*frames[:1] * 6, *frames, *frames[-1:] * 10]
    frames[0].save(
        folder / "plan.webp",
        save_all=True,
        append_images=frames[1:],
        duration=100,
        loop=0,
        quality=50,
        method=6,
    )


def _with_depth(frame: Image.Image, depth: NDArray[np.uint16]) -> Image.Image:
    """A frame with the depth picture in its corner: near is light, no reading is dark."""
    nearest, farthest = depth[depth > 0].min(), depth.max()
    grey = np.where(depth > 0, 255 - 200 * ((depth - float(nearest)) / (farthest - nearest)), 0)
    inset = Image.fromarray(grey.astype(np.uint8)).convert("RGB")
    inset = inset.resize((INSET_PX, INSET_PX * inset.height // inset.width), Image.Resampling.NEAREST)
    frame.paste(ImageOps.expand(inset, 2, "black"), (12, 12))
    return frame


def _taken(page: Page, address: str, scheme: str) -> bytes:
    """A planned path, a little less than half of it travelled."""
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")  # type: ignore[arg-type]
    # The first answer of a server takes longer than it usually does.
    for _ in range(2):
        open_bench(page, address)
    plan(page)
    expect(page.locator("#plan-status")).to_contain_text("Checked")
    page.get_by_role("slider", name="Along the path").evaluate(
        "(slider) => { slider.value = 450; slider.dispatchEvent(new Event('input')); slider.blur(); }"
    )
    return page.screenshot(full_page=True, animations="disabled")


def _write(taken: bytes, path: Path) -> None:
    """With a palette, which takes a quarter of the space."""
    with Image.open(io.BytesIO(taken)) as picture:
        picture.convert("RGB").quantize(
            COLOURS, Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE
        ).save(path, optimize=True)


if __name__ == "__main__":
    sys.exit(main())
