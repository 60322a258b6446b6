"""The source archive of a package, through pip and its configuration, without building anything."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from cspace.errors import ServiceError
from training.motionbench.archive import PACKAGE, VERSION

_TIMEOUT_S = 900.0
# pip asks the build backend for a name and a version; the package's own would configure a C++ build for it.
_BACKEND = f"""
from pathlib import Path

def prepare_metadata_for_build_wheel(folder, settings=None):
    made = Path(folder, "{PACKAGE.replace("-", "_")}-{VERSION}.dist-info")
    made.mkdir()
    (made / "METADATA").write_text("Metadata-Version: 2.1\\nName: {PACKAGE}\\nVersion: {VERSION}\\n")
    return made.name
"""


@contextmanager
def downloaded(sha256: str) -> Iterator[Path]:
    """Yield the path of the archive, which is deleted after the block.

    pip checks its SHA-256 sum before it unpacks it.

    Args:
        sha256: the sum that the archive must have.

    Raises:
        ServiceError: pip is missing, fails, finds another archive under this version, or takes longer
            than a quarter of an hour.
    """
    with TemporaryDirectory() as temporary:
        backend, out = Path(temporary, "backend", "scikit_build_core"), Path(temporary, "out")
        backend.mkdir(parents=True)
        (backend / "__init__.py").touch()
        (backend / "build.py").write_text(_BACKEND, encoding="utf-8")
        wanted = Path(temporary, "requirements.txt")
        wanted.write_text(f"{PACKAGE}=={VERSION} --hash=sha256:{sha256}\n", encoding="utf-8")
        _run(backend.parent, wanted, out)
        found = list(out.glob("*.tar.gz"))
        if len(found) != 1:
            raise _failed(f"{[path.name for path in found]}")
        yield found[0]


def _run(backend: Path, wanted: Path, out: Path) -> None:
    before = os.environ.get("PYTHONPATH")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(backend), *([before] if before else [])])}
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-input", "--no-deps"]
    command += ["--no-build-isolation", "--no-binary", PACKAGE, "--dest", str(out)]
    command += ["--require-hashes", "--requirement", str(wanted)]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False, timeout=_TIMEOUT_S
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _failed(str(error)) from error
    if done.returncode:
        raise _failed(" ".join(done.stderr.split()) or f"exit code {done.returncode}")


def _failed(got: str) -> ServiceError:
    return ServiceError(
        "the benchmark's archive cannot be fetched",
        expected=f"pip to download the source archive of {PACKAGE} {VERSION}",
        got=got[-300:],
        remedy="check pip's configuration, or give an archive that was fetched elsewhere with --archive",
    )
