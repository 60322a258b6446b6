"""A server as docker/kuberay/inference-api.yaml starts it: kernels in the image, and two folders to write."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
import yaml

ROOT = Path(__file__).parents[2]
UNSHARE = ("unshare", "-m")
MANIFEST = ROOT / "docker" / "kuberay" / "inference-api.yaml"
# In a mount namespace of its own: everything is read only but the folders of the manifest.
START = """
set -eu
mount --make-rprivate /
for place in "$FOLDER" "$CLONE"; do mount --bind "$place" "$place"; mount -o remount,ro,bind "$place"; done
mount -o remount,ro,bind /
for place in models tmp; do mount -t tmpfs none "$FOLDER/$place"; done
cd "$CLONE"
! touch "$NUMBA_CACHE_DIR/written" 2> /dev/null
exec "$PYTHON" -m inference_api --port 0
"""


def has_namespaces() -> bool:
    if not hasattr(os, "geteuid") or os.geteuid() != 0:
        return False
    try:
        return subprocess.run([*UNSHARE, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def writable_mounts() -> set[str]:
    deployment = next(yaml.safe_load_all(MANIFEST.read_text(encoding="utf-8")))
    (container,) = deployment["spec"]["template"]["spec"]["containers"]
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    assert container["readinessProbe"]["httpGet"]["path"] == "/health/ready"
    return {mount["mountPath"] for mount in container["volumeMounts"] if not mount.get("readOnly")}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not has_namespaces(), reason="needs root and mount namespaces")
def test_the_kernels_of_the_image_are_found_on_a_read_only_root(tmp_path: Path) -> None:
    assert writable_mounts() == {"/var/lib/cspace/models", "/tmp"}  # noqa: S108 - the manifest's
    for name in ("models", "tmp", "kernels"):
        (tmp_path / name).mkdir()
    kernels = tmp_path / "kernels"
    environment = {
        **os.environ,
        "CLONE": str(ROOT),
        "CSPACE_MODEL_CACHE": str(tmp_path / "models"),
        "FOLDER": str(tmp_path),
        "HOME": str(tmp_path / "nowhere"),
        "NUMBA_CACHE_DIR": str(kernels),
        "PYTHON": sys.executable,
        "PYTHONPATH": str(ROOT),
        "PYTHONUNBUFFERED": "1",
        "TMPDIR": str(tmp_path / "tmp"),
    }
    # As the image is built.
    subprocess.run([sys.executable, "-m", "cspace.plan"], env=environment, cwd=ROOT, check=True)
    command = [*UNSHARE, "bash", "-c", START]
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as server:
        try:
            assert server.stderr is not None
            found = (re.search(r"running on (http://\S+)", line) for line in server.stderr)
            plans_at(next(match[1] for match in found if match))
        finally:
            server.terminate()


def plans_at(address: str) -> None:
    began = time.monotonic()
    while httpx.get(f"{address}/health/ready", timeout=30).status_code != 200:
        assert time.monotonic() - began < 60
        time.sleep(0.2)
    picture = (ROOT / "docs" / "images" / "scenario.png").read_bytes()
    fields = {"start": "[1.5, 0.5]", "goal": "[-1.5, 0.5]"}
    began = time.monotonic()
    answer = httpx.post(f"{address}/plan", files={"image": picture}, data=fields, timeout=100)
    assert answer.status_code == 200, answer.text
    # Compiling would take most of a minute.
    assert time.monotonic() - began < 10
