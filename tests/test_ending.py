"""What a test run leaves when it is ended from outside."""

import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_a_run_that_is_terminated_ends_what_its_fixtures_started(tmp_path: Path) -> None:
    (tmp_path / "test_long.py").write_text(
        textwrap.dedent("""
        import pathlib, time, pytest
        here = pathlib.Path(__file__).parent

        @pytest.fixture(scope="session")
        def server():
            (here / "started").touch()
            yield
            (here / "ended").touch()

        def test_long(server):
            time.sleep(60)
        """)
    )
    command = [sys.executable, "-m", "pytest", "-q", "-p", "tests.ending", "-p", "no:cacheprovider"]
    run = subprocess.Popen(
        [*command, str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        stdout=subprocess.DEVNULL,
    )
    while not (tmp_path / "started").exists():
        assert run.poll() is None
        time.sleep(0.05)
    run.terminate()
    assert run.wait(30) != 0
    assert (tmp_path / "ended").exists()
