"""A state folder and ports of its own, and stubs in place of the programs of the environment."""

import shutil
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.local import quickstart, stack
from services.local.stack import BIN, Settings, down, free_ports

# Serves each health page on its port, and starts a process that leaves its process group.
STUB = f"""#!{sys.executable} -S
import http.server, re, subprocess, sys
if "get-auth-token" in sys.argv:
    sys.exit()
if "training.untrained" in sys.argv:
    sys.exit(print("  registered as bench-arm-5-sampler/1"))
if "services.planner" in sys.argv:
    sys.exit(open(sys.argv[-1], "w").close())
port = max(int(number) for number in re.findall(r"--(?:dashboard-)?port=(\\d+)", " ".join(sys.argv)))
print(f"http://127.0.0.1:{{port}}/?token=secret", flush=True)
subprocess.Popen(["sleep", "300"], start_new_session=True)
class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200 if re.search("health|models", self.path) else 403)
        self.end_headers()
        self.wfile.write(b'{{"models": [{{"reference": "bench-arm-5-sampler/1", "default": false}}]}}')
http.server.HTTPServer(("127.0.0.1", port), Handler).serve_forever()
"""

WriteStub = Callable[[str, str], None]


def ignore(line: str) -> None:
    """Nobody reads."""


def settings_in(home: Path) -> Settings:
    api, ray, mlflow, viewer = free_ports(4)
    return Settings(home=home, api_port=api, ray_port=ray, mlflow_port=mlflow, viewer_port=viewer)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """What the commands read of the environment."""
    made = settings_in(tmp_path / "the state")
    for name, value in made.model_dump().items():
        monkeypatch.setenv(f"CSPACE_{name.upper()}", str(value))
    # main() sets these for its process; the test's own environment gets them back.
    for name in ("NO_PROXY", "no_proxy", "RAY_AUTH_MODE"):
        monkeypatch.setenv(name, "")
    return made


@pytest.fixture
def write_stub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WriteStub:
    """Put a program into the folder that stands for the environment's."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for module in (stack, quickstart):
        monkeypatch.setattr(module, "BIN", folder)

    def write(name: str, program: str) -> None:
        (folder / name).write_text(program)
        (folder / name).chmod(stat.S_IRWXU)

    return write


@pytest.fixture
def programs(settings: Settings, write_stub: WriteStub, tmp_path: Path) -> Iterator[None]:
    """A real supervisord, with stubs in place of what it starts."""
    for name in ("mlflow", "ray", "python"):
        write_stub(name, STUB)
    (tmp_path / "bin" / "supervisord").symlink_to(BIN / "supervisord")
    yield
    down(settings, ignore)
    shutil.rmtree(settings.temp_folder, ignore_errors=True)
