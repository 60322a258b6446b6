"""Shows your own pictures: a view file or a recording, and what the doctor says of them."""

import asyncio
import json
import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cspace.errors import CspaceError, InputError
from cspace.world import World
from cspace_client import ClientError
from services.planner.viewer.access import UPLOAD_BYTES, UPLOADS
from services.planner.viewer.scene import as_text

RECORDINGS, IMPORT_S = (".mcap", ".db3"), 120
REFUSED = f"Refused: at most {UPLOADS} files of {UPLOAD_BYTES >> 20} MiB in all are read at a time."
# viser takes files by a button only: what is dropped is given to the button's field.
DROP_ZONE = """
<div style="margin:0 0.5em;padding:1em;border:2px dashed #999;border-radius:4px;text-align:center"
     ondragover="event.preventDefault()"
     ondrop="event.preventDefault(); const field = document.querySelector('input[type=file]');
             field.files = event.dataTransfer.files; field.dispatchEvent(new Event('change', {bubbles: 1}))">
  Drop a view file or a recording of ROS 2 here</div>
"""


class UploadPanel:
    """Controls of uploaded files."""

    def __init__(self, viewer: Any) -> None:
        self.viewer, self.state = viewer, viewer.state
        self.views: list[bytes] = []
        gui = viewer.server.gui
        with gui.add_folder("Your own pictures"):
            gui.add_html(DROP_ZONE)
            self.button: Any = gui.add_upload_button("Open a file")
            self.base = gui.add_text("base frame", "base_link")
            self.which: Any = gui.add_slider("view of the recording", 0, 1, 1, 0, visible=False)
            self.doctor = gui.add_html("")
        self.button.on_upload(self._uploaded)
        self.which.on_update(lambda _: viewer.guarded(self._show))

    def say(self, words: str) -> None:
        """Shows words where the user has dropped the file."""
        self.doctor.content = as_text(words)

    def forget(self) -> None:
        """Another scene is shown."""
        self.views, self.which.visible, self.doctor.content = [], False, ""

    async def _uploaded(self, _: object) -> None:
        file, reading = self.button.value, self.viewer.bounds.reading
        reading.append(len(file.content))
        try:
            await asyncio.to_thread(self.viewer.guarded, partial(self._open, file.name, file.content))
        finally:
            reading.remove(len(file.content))

    def _open(self, name: str, content: bytes) -> None:
        """Shows a view file, or the first view of a recording."""
        self.say(f"Reading {name} ...")
        try:
            self.views = [content]
            if name.endswith(RECORDINGS):
                self.views = views_of_recording(name, content, self.state.world, self.base.value)
            self.which.value, self.which.visible = 0, len(self.views) > 1
            self.which.max = max(1, len(self.views) - 1)
            self._show()
        except (CspaceError, ClientError) as error:
            self.say(str(error))

    def _show(self) -> None:
        if not self.views:
            return
        self.state.open(self.views[int(self.which.value)])
        scene = self.viewer.scene
        scene.unseen.value = True
        scene.show_ends()
        # First what needs no answer of the API, for that may fail.
        scene.show()
        self.say(self.state.findings())


def views_of_recording(name: str, content: bytes, world: World, base: str) -> list[bytes]:
    """View files of a recording, imported as the command line does; ``base`` is the arm's tf frame."""
    with TemporaryDirectory() as folder:
        source, arm, into = Path(folder) / Path(name).name, Path(folder) / "arm.json", Path(folder) / "views"
        source.write_bytes(content)
        arm.write_text(json.dumps(world.body.to_dict()))
        command = [sys.executable, "-m", "training.data", "import-recording", str(source), str(into)]
        command += [f"--arm={arm}", f"--base={base}", f"--time-limit={IMPORT_S}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            expected = "a recording of ROS 2 with depth images, cameras, joint states and transforms"
            got, remedy = done.stderr.strip()[-400:], "see python -m training.data import-recording --help"
            raise InputError(f"{name} cannot be imported", expected=expected, got=got, remedy=remedy)
        return [path.read_bytes() for path in sorted((into / "views").iterdir())]
