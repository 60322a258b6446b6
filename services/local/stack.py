"""The services of this machine under one supervisord: settings, state folder, up, down and status."""

import hashlib
import http.client
import os
import shutil
import socket
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from string import Template
from typing import Annotated, Any

import httpx
import psutil
from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from supervisor.states import RUNNING_STATES
from supervisor.xmlrpc import SupervisorTransport

from cspace.errors import ConfigError, PortTakenError, ServiceError
from cspace.files import holding
from services.commands import aligned
from services.names import API_URL
from services.outcomes import FOLDER as OUTCOMES

HOST = "127.0.0.1"
ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
# What supervisord's configuration would read as more than a part of a path.
SPECIAL = frozenset("\"'\\;#%\n")
MARKER, IGNORE = ".cspace-sampler.json", ".gitignore"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models", "arms")

Port = Annotated[int, Field(ge=1, le=65535)]


def _default_home() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "cspace-sampler"


class Settings(BaseSettings):
    """Where the services keep their state, and on which loopback ports they listen."""

    model_config = SettingsConfigDict(env_prefix="CSPACE_", env_ignore_empty=True, frozen=True)

    home: Path = Field(default_factory=_default_home)
    api_port: Port = 8000
    ray_port: Port = 8265
    mlflow_port: Port = 5000
    viewer_port: Port = 8090
    # Local trials run beside each other, so that even one core offers two places.
    ray_cpus: int = Field(default_factory=lambda: max(2, len(os.sched_getaffinity(0))), ge=1, le=1024)

    @field_validator("home")
    @classmethod
    def _own_folder(cls, home: Path) -> Path:
        # `clean-state` deletes below this folder.
        shared = {Path.home(), ROOT, *Path.home().parents, *ROOT.parents}
        if not home.is_absolute() or home in shared or home.is_file() or SPECIAL & set(str(home)):
            raise ValueError(f"expected an absolute folder of its own, without any of {''.join(SPECIAL)!r}")
        return home

    def url(self, name: str) -> str:
        """Address of ``api``, ``ray``, ``mlflow`` or ``viewer``."""
        return f"http://{HOST}:{getattr(self, f'{name}_port')}"

    @property
    def temp_folder(self) -> Path:
        """Folder of Ray's session and of sockets, whose paths have to be short."""
        digest = hashlib.sha256(os.fsencode(self.home)).hexdigest()[:8]
        return Path(f"/tmp/cspace-{os.getuid()}-{digest}")  # noqa: S108

    @property
    def socket(self) -> Path:
        """Where supervisord listens."""
        return self.temp_folder / "supervisor.sock"


def shell_values(settings: Settings) -> dict[str, str]:
    """The environment variables with which `ray job submit` and the project's commands find the services."""
    return {
        "RAY_AUTH_MODE": "token",
        "RAY_ADDRESS": settings.url("ray"),
        API_URL: settings.url("api"),
        OUTCOMES: str(settings.home / "data" / "outcomes"),
        "MLFLOW_TRACKING_URI": settings.url("mlflow"),
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Progress bars and addresses turn a log into noise.
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    }


def make_state(settings: Settings) -> None:
    """Make the state folder with its parts; a folder that holds something else is refused."""
    home = settings.home
    home.mkdir(mode=0o700, parents=True, exist_ok=True)
    _require_own(home)
    (home / MARKER).write_text('{"made_by": "cspace-sampler"}', encoding="utf-8")
    # Git and `ray job submit --working-dir` leave the folder out.
    (home / IGNORE).write_text("*\n", encoding="utf-8")
    for name in FOLDERS:
        (home / name).mkdir(exist_ok=True)


def state_parts(settings: Settings) -> list[Path]:
    """What :func:`drop_state` would delete."""
    if not settings.home.is_dir():
        return []
    _require_own(settings.home)
    parts = [*(settings.home / name for name in FOLDERS), settings.temp_folder]
    return [part for part in parts if part.is_dir()]


def drop_state(settings: Settings) -> None:
    """Delete the parts of the state folder, and the folder itself if nothing else lies in it."""
    for part in state_parts(settings):
        shutil.rmtree(part)
    # The mark goes last, so that what was interrupted can be repeated.
    for name in (IGNORE, MARKER):
        (settings.home / name).unlink(missing_ok=True)
    if not any(settings.home.iterdir()):
        settings.home.rmdir()


def size_text(folder: Path) -> str:
    """The size of the files below a folder; links are not followed."""
    total = 0
    for path in folder.rglob("*"):
        with suppress(OSError):  # deleted in between
            total += path.lstat().st_size if not path.is_dir() else 0
    return f"{total / 1e6:.1f} MB"


def _require_own(home: Path) -> None:
    found = sorted(path.name for path in home.iterdir())
    if found and MARKER not in found:
        what, got = f"{home} is not a state folder of this project", ", ".join(found[:5])
        raise ConfigError(what, expected="a new or an empty folder", got=got, remedy="set CSPACE_HOME to one")


SERVICES = ("mlflow", "ray", "api")
HEALTH = {"mlflow": "/health", "ray": "/api/gcs_healthz", "api": "/health/ready", "viewer": "/"}
# supervisord and all that it starts have the state folder in this variable of their environment.
STACK = "CSPACE_STACK"
# This file is there while the API runs without MLflow.
NO_REGISTRY = "run/no-registry"
# What a user's shell says about other clusters and servers would lead jobs astray; his token is his.
FOREIGN, OWN = ("RAY_", "MLFLOW_", "PYTHONHOME"), ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")
POLL_S = 0.2
START_LIMIT_S, STOP_LIMIT_S, KILL_LIMIT_S = 180.0, 90.0, 10.0

Report = Callable[[str], None]


def up(settings: Settings, names: Sequence[str], report: Report) -> None:
    """Start what does not run, and wait until all is healthy.

    A port that somebody else has ends it before anything starts. A service that does not come up is stopped
    again; the others go on.
    """
    make_state(settings)
    began = time.monotonic()
    with _lock(settings):
        server = connect(settings)
        if server is None:
            end_processes(leftovers(settings))
        elif server.getIdentification() != _identifier(settings):
            raise ServiceError(
                "the services run from another checkout or on other ports",
                expected=_identifier(settings),
                got=server.getIdentification(),
                remedy="`make down` first, or set CSPACE_HOME and the ports to others for this checkout",
            )
        _choose_registry(settings, server, names)
        absent = [
            name
            for name in names
            if server is None or server.getProcessInfo(name)["state"] not in RUNNING_STATES
        ]
        for name in absent:
            _require_free(settings, name)
        server = server or _start_supervisord(settings)
        for name in absent:
            if name == "viewer":
                server.clearProcessLogs(name)  # of addresses that are gone
            # One that ends at once is told by _wait_healthy, with its log.
            with suppress(xmlrpc.client.Fault):
                server.startProcess(name, False)  # noqa: FBT003
            report(f"{name}: starting, log {log_file(settings, name)}")
        for name in names:
            _wait_healthy(settings, server, name)
            state = f"ready after {time.monotonic() - began:.1f} s" if name in absent else "runs already"
            report(f"{name}: {state}, {settings.url(name)}")


def down(settings: Settings, report: Report) -> bool:
    """End supervisord and all that it started; whether anything ran."""
    if not (settings.home / "run").is_dir():
        return False
    with _lock(settings):
        server, found = connect(settings), leftovers(settings)
        if server is not None:
            running = [info["name"] for info in server.getAllProcessInfo() if info["state"] in RUNNING_STATES]
            supervisord = psutil.Process(server.getPID())
            server.shutdown()
            psutil.wait_procs([supervisord], timeout=STOP_LIMIT_S)
            report(f"ended: {', '.join(running) or 'supervisord'}")
        # What a killed supervisord left behind, and what left the process group of its service.
        left = end_processes({*found, *leftovers(settings)})
        if left:
            report(f"ended what was left behind: {left} processes")
    return bool(found)


def status(settings: Settings) -> tuple[str, bool]:
    """A table of the services, and of the viewer once it was started; whether all is healthy."""
    server = connect(settings)
    infos = {} if server is None else {info["name"]: info for info in server.getAllProcessInfo()}
    shown = [name for name in HEALTH if name in SERVICES or (name in infos and infos[name]["start"])]
    running = {name for name, info in infos.items() if info["state"] in RUNNING_STATES}
    answers = {name: name in running and healthy(settings, name) for name in shown}
    rows = [("service", "state", "", "health", "address")]
    for name in shown:
        state, description = (infos[name][key] if infos else "" for key in ("statename", "description"))
        health = "healthy" if answers[name] else "not healthy"
        url = viewer_page(settings) if name == "viewer" else settings.url(name)
        rows.append((name, state or "not running", description, health, url))
    return aligned(rows), all(answers.values())


class _Transport(SupervisorTransport):  # type: ignore[misc]
    def __del__(self) -> None:
        """Close the connection, which supervisor's own class leaves open."""
        self.close()


def connect(settings: Settings) -> Any:
    """Supervisord's XML-RPC interface, or None where it does not answer."""
    transport = _Transport(serverurl=f"unix://{settings.socket}")
    # The transport knows the socket; the proxy wants an address nevertheless.
    server = xmlrpc.client.ServerProxy("http://127.0.0.1", transport=transport).supervisor
    try:
        server.getState()
    except (OSError, http.client.HTTPException, xmlrpc.client.Error):
        return None
    return server


def leftovers(settings: Settings) -> set[psutil.Process]:
    """Supervisord and all that it started, also when supervisord itself was killed.

    Ray's agents write titles over their environment: they are found as children.
    """
    found: set[psutil.Process] = set()
    for process in psutil.process_iter(["environ"]):
        if (process.info["environ"] or {}).get(STACK) == str(settings.home):
            with suppress(psutil.Error):  # it may end in between
                found |= {process, *process.children(recursive=True)}
    return {process for process in found if process.pid != os.getpid() and _is_alive(process)}


def end_processes(processes: Iterable[psutil.Process]) -> int:
    """End those that still run; how many ran. psutil compares start times before it sends a signal."""
    alive = [process for process in processes if _is_alive(process)]
    count = len(alive)
    for send in (psutil.Process.terminate, psutil.Process.kill):
        for process in alive:
            with suppress(psutil.Error):
                send(process)
        _, alive = psutil.wait_procs(alive, timeout=KILL_LIMIT_S)
    return count


def healthy(settings: Settings, name: str) -> bool:
    """Whether a service answers."""
    with suppress(httpx.HTTPError):
        code = httpx.get(settings.url(name) + HEALTH[name], timeout=5.0, trust_env=False).status_code
        if name == "viewer":
            # It prints its address once it listens, and may refuse whoever comes without its token.
            return code < 500 and viewer_page(settings) != ""
        return code == httpx.codes.OK
    return False


def viewer_page(settings: Settings) -> str:
    """The last address that the viewer printed, with its token; empty before that."""
    with suppress(OSError):
        lines = log_file(settings, "viewer").read_text(encoding="utf-8", errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.startswith("http://")), "")
    return ""


def log_file(settings: Settings, name: str) -> Path:
    """The log of a service, or of supervisord."""
    return settings.home / "logs" / f"{name}.log"


def free_ports(count: int) -> list[int]:
    """Different free loopback ports, chosen by the system."""
    sockets = [socket.create_server((HOST, 0)) for _ in range(count)]
    ports = [int(one.getsockname()[1]) for one in sockets]
    for one in sockets:
        one.close()
    return ports


def _start_supervisord(settings: Settings) -> Any:
    kept = {name: value for name, value in os.environ.items() if name in OWN or not name.startswith(FOREIGN)}
    path = os.pathsep.join([str(BIN), os.environ.get("PATH") or os.defpath])
    environment = kept | {"PATH": path, STACK: str(settings.home)}
    # Made once in a user's home folder, if it is not there.
    command = [str(BIN / "ray"), "get-auth-token", "--generate"]
    subprocess.run(command, env=environment, capture_output=True, check=False)
    shutil.rmtree(settings.temp_folder, ignore_errors=True)
    # A folder that somebody else has made cannot be deleted, and is not used.
    settings.temp_folder.mkdir(mode=0o700)
    config = settings.home / "run" / "supervisord.conf"
    config.write_text(_configuration(settings), encoding="utf-8")
    command = [str(BIN / "supervisord"), "-c", str(config)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    # It goes into the background once it listens.
    server = connect(settings)
    if server is None:
        log = log_file(settings, "supervisord")
        raise ServiceError("supervisord did not start", got=done.stderr[-500:], remedy=f"see {log}")
    return server


def _configuration(settings: Settings) -> str:
    values = settings.model_dump() | {"bin": BIN, "identifier": _identifier(settings), "root": ROOT}
    values |= {"socket": settings.socket, "temp_folder": settings.temp_folder}
    values["no_registry"] = settings.home / NO_REGISTRY
    # Empty switches them off; another folder would be that of another state folder.
    off = os.environ.get(OUTCOMES) == ""
    values["outcomes"] = "" if off else shell_values(settings)[OUTCOMES]
    values["ray_client_port"], values["ray_agent_port"] = free_ports(2)
    template = Template(Path(__file__).with_name("supervisord.conf").read_text(encoding="utf-8"))
    # supervisord expands %(name)s in values.
    return template.substitute({name: str(value).replace("%", "%%") for name, value in values.items()})


def _choose_registry(settings: Settings, server: Any, names: Sequence[str]) -> None:
    """Have the API start without a registry where MLflow does not, and restart once it does."""
    running = {name for name in SERVICES if server and server.getProcessInfo(name)["state"] in RUNNING_STATES}
    mark = settings.home / NO_REGISTRY
    if "mlflow" not in {*names, *running}:
        mark.touch()
    elif mark.exists():
        mark.unlink()
        if "api" in running:
            server.stopProcess("api")


def _identifier(settings: Settings) -> str:
    return " ".join([str(ROOT), *(settings.url(name) for name in HEALTH)])


def _lock(settings: Settings) -> AbstractContextManager[None]:
    busy = "another command is starting or ending these services"
    return holding(settings.home / "run" / "lock", ServiceError(busy, remedy="run this again after it"))


def _require_free(settings: Settings, name: str) -> None:
    port, setting = getattr(settings, f"{name}_port"), f"CSPACE_{name.upper()}_PORT"
    with socket.socket() as client:
        if client.connect_ex((HOST, port)) == 0:
            remedy = f"end its program (`ss -ltnp` lists it), or set {setting} to another port"
            raise PortTakenError(f"port {port} of {name} is taken", remedy=remedy)


def _wait_healthy(settings: Settings, server: Any, name: str) -> None:
    pid, until, failure = server.getProcessInfo(name)["pid"], time.monotonic() + START_LIMIT_S, ""
    while not failure and not healthy(settings, name):
        info = server.getProcessInfo(name)
        if info["pid"] != pid or info["state"] not in RUNNING_STATES:
            failure = "ended while it was starting"
        elif time.monotonic() > until:
            failure = f"did not answer within {START_LIMIT_S:.0f} s"
        else:
            time.sleep(POLL_S)
    if failure:
        with suppress(xmlrpc.client.Fault):  # it has ended already
            server.stopProcess(name)
        log = log_file(settings, name)
        last = log.read_text(encoding="utf-8", errors="replace").splitlines()[-25:]
        remedy = "\n".join([f"the end of its log {log}:", *last, "then `make down` and start again"])
        raise ServiceError(f"{name} {failure}", remedy=remedy)


def _is_alive(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False
