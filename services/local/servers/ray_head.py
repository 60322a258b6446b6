"""The Ray head with its dashboard and jobs API, on loopback and behind a token."""

import hashlib
import os
import re
import shutil
import tempfile
from pathlib import Path

from cspace.errors import ServiceStartError
from services.local.environment import binaries, service_environment
from services.local.servers.health import answers
from services.local.servers.ports import free_ports
from services.local.servers.ray_jobs import jobs_under_way
from services.local.servers.ray_token import ensure_token, token_headers
from services.local.servers.service import Service
from services.local.settings import HOST, RAY_PORT, Settings

OBJECT_STORE_BYTES = 500_000_000
# The path of a Unix socket ends at 103 bytes on macOS (107 on Linux), and Ray appends 64 to its folder.
MAX_TEMP_PATH = 38
# Ray starts its processes by a shell that is given their paths without quotes.
_SHELL = re.compile(r"""[][\s"'`$&;()<>|*?#\\:]""")


def ray_head(settings: Settings) -> Service:
    """``ray start --head --block``: jobs run in the project's root with the services' environment."""
    environment = service_environment(settings)
    return Service(
        name="ray",
        title="Ray",
        address=settings.ray_url,
        port=settings.ray_port,
        setting=RAY_PORT,
        command=lambda: _command(settings),
        environment=environment,
        folder=settings.root,
        ready=lambda: answers(f"{settings.ray_url}/api/jobs/", token_headers(environment)),
        start_limit_s=180.0,
        stop_grace_s=20.0,
        prepare=lambda: _prepare(settings, environment),
        interrupts=lambda: jobs_under_way(settings.ray_url, token_headers(environment)),
    )


def temp_folder(settings: Settings) -> Path:
    """Ray's folder for sockets and session logs: short, and different for each state folder."""
    name = f"cspace-{os.getuid()}-{hashlib.sha256(os.fsencode(settings.home)).hexdigest()[:8]}"
    preferred = Path(tempfile.gettempdir()) / name
    # Ray fails on the length of a socket's path, and on a space in it.
    fits = len(os.fsencode(preferred)) <= MAX_TEMP_PATH and not _SHELL.search(str(preferred))
    return preferred if fits else Path("/tmp") / name  # noqa: S108


def _command(settings: Settings) -> tuple[str, ...]:
    client, agent = free_ports(2)
    return (
        str(binaries() / "ray"),
        "start",
        "--head",
        "--block",
        f"--node-ip-address={HOST}",
        # Ports that nobody needs to know are free ones, so that another Ray on this machine is no hindrance.
        "--port=0",
        "--min-worker-port=0",
        "--max-worker-port=0",
        f"--ray-client-server-port={client}",
        f"--dashboard-agent-listen-port={agent}",
        "--include-dashboard=true",
        f"--dashboard-host={HOST}",
        f"--dashboard-port={settings.ray_port}",
        f"--num-cpus={settings.ray_cpus}",
        f"--object-store-memory={OBJECT_STORE_BYTES}",
        f"--temp-dir={temp_folder(settings)}",
        "--disable-usage-stats",
        "--log-color=false",
    )


def require_plain(folder: Path) -> None:
    """Refuse a path below which Ray cannot run.

    Raises:
        ServiceStartError: it has a space, or a character that means something to a shell.
    """
    if _SHELL.search(str(folder)):
        raise ServiceStartError(
            f"Ray cannot run below the folder '{folder}'",
            expected="a path without spaces and characters of the shell",
            remedy="move the project, delete its .venv, and run make there",
        )


def _prepare(settings: Settings, environment: dict[str, str]) -> None:
    for used in (settings.root, binaries()):
        require_plain(used)
    folder = temp_folder(settings)
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise ServiceStartError(
            f"{folder} belongs to somebody else", remedy="set TMPDIR to a folder of yours with a short path"
        )
    _drop_old_sessions(folder)
    ensure_token(environment)


def _drop_old_sessions(folder: Path) -> None:
    """Delete all sessions but the last, whose logs may still be wanted."""
    sessions = [path for path in folder.glob("session_*") if path.is_dir() and not path.is_symlink()]
    for path in sorted(sessions)[:-1]:
        shutil.rmtree(path, ignore_errors=True)
