"""The services of this machine under one supervisord: up, down and status."""

import http.client
import os
import shutil
import socket
import subprocess
import time
import xmlrpc.client
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import httpx
import psutil
from supervisor.states import RUNNING_STATES
from supervisor.xmlrpc import SupervisorTransport

from cspace.errors import PortTakenError, ServiceError, ServiceStartError
from cspace.files import holding
from services.local.settings import BIN, HOST, ROOT, Settings, service_environment
from services.local.state import make_state
from services.names import EXPERIMENT, MLFLOW_TRAINING

SERVICES = ("mlflow", "ray", "api")
# supervisord and all that it starts have the state folder in this variable of their environment.
STACK = "CSPACE_STACK"
HEALTH = {"mlflow": "/health", "ray": "/api/gcs_healthz", "api": "/health/ready", "viewer": "/"}
POLL_S = 0.2
START_LIMIT_S, STOP_LIMIT_S, KILL_LIMIT_S, SUPERVISORD_LIMIT_S = 180.0, 90.0, 10.0, 20.0
LOG_LINES = 25

Report = Callable[[str], None]


@dataclass(frozen=True)
class Status:
    """A service as supervisord describes it, and whether it answers."""

    name: str
    state: str
    description: str
    healthy: bool
    url: str


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
        absent = [name for name in names if server is None or not _runs(server.getProcessInfo(name))]
        for name in absent:
            _require_free(settings, name)
        server = server or _start_supervisord(settings)
        for name in absent:
            if name == "viewer":
                server.clearProcessLogs(name)  # of addresses that are gone
            server.startProcess(name, False)  # noqa: FBT003
            report(f"{name}: starting, log {log_file(settings, name)}")
        for name in names:
            _wait_healthy(settings, server, name)
            state = f"ready after {time.monotonic() - began:.1f} s" if name in absent else "runs already"
            report(f"{name}: {state}, {url_of(settings, name)}")


def down(settings: Settings, report: Report) -> bool:
    """End supervisord and all that it started; whether anything ran. What that interrupts is told first."""
    if not (settings.home / "run").is_dir():
        return False
    with _lock(settings):
        server, found = connect(settings), leftovers(settings)
        if server is not None:
            running = [info["name"] for info in server.getAllProcessInfo() if _runs(info)]
            if "ray" in running:
                _report_jobs(settings, report)
            supervisord = psutil.Process(server.getPID())
            server.shutdown()
            psutil.wait_procs([supervisord], timeout=STOP_LIMIT_S)
            report(f"ended: {', '.join(reversed(running)) or 'supervisord'}")
        # What a killed supervisord left behind, and what left the process group of its service.
        end_processes({*found, *leftovers(settings)})
    return bool(found)


def status(settings: Settings) -> list[Status]:
    """The services, and the viewer if it was started."""
    server = connect(settings)
    if server is None:
        return [Status(name, "STOPPED", "", healthy=False, url=url_of(settings, name)) for name in SERVICES]
    infos = {info["name"]: info for info in server.getAllProcessInfo()}
    shown = [name for name in HEALTH if name in SERVICES or infos[name]["start"]]
    return [
        Status(
            name,
            infos[name]["statename"],
            infos[name]["description"],
            healthy=_runs(infos[name]) and healthy(settings, name),
            url=url_of(settings, name),
        )
        for name in shown
    ]


def connect(settings: Settings) -> Any:
    """Supervisord's XML-RPC interface, or None where it does not answer."""
    transport = SupervisorTransport(serverurl=f"unix://{_socket(settings)}")
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


def end_processes(processes: Iterable[psutil.Process]) -> None:
    """End processes, and kill those that do not end; psutil checks their start times first."""
    alive = [process for process in processes if _is_alive(process)]
    for send in (psutil.Process.terminate, psutil.Process.kill):
        for process in alive:
            with suppress(psutil.Error):
                send(process)
        _, alive = psutil.wait_procs(alive, timeout=KILL_LIMIT_S)


def healthy(settings: Settings, name: str) -> bool:
    """Whether a service answers. The viewer may refuse whoever comes without its token."""
    with suppress(httpx.HTTPError):
        url = f"http://{HOST}:{getattr(settings, f'{name}_port')}{HEALTH[name]}"
        code = httpx.get(url, timeout=5.0, trust_env=False).status_code
        return code == httpx.codes.OK or (name == "viewer" and code < 500 and viewer_page(settings) != "")
    return False


def viewer_page(settings: Settings) -> str:
    """The last address that the viewer printed, with its token; empty before that."""
    with suppress(OSError):
        lines = log_file(settings, "viewer").read_text(encoding="utf-8", errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.startswith("http://")), "")
    return ""


def url_of(settings: Settings, name: str) -> str:
    """Where a service is for people."""
    page = viewer_page(settings) if name == "viewer" else ""
    return page or f"http://{HOST}:{getattr(settings, f'{name}_port')}"


def log_file(settings: Settings, name: str) -> Path:
    """The log of a service, or of supervisord."""
    return settings.home / "logs" / f"{name}.log"


def addresses(settings: Settings) -> str:
    """Where to look, and how to set a shell up for jobs of one's own."""
    return "\n".join(
        [
            f"MLflow UI       {experiment_address(settings.mlflow_url)}",
            f"Ray dashboard   {settings.ray_url}  (asks for the token: `ray get-auth-token` prints it)",
            f"API             {settings.api_url}/docs",
            f"workbench       {settings.api_url}/",
            "",
            "This line sets a shell up for `ray job submit training/cluster_train.py`:",
            '  eval "$(.venv/bin/python -m services.local env)"',
        ]
    )


def experiment_address(mlflow_url: str) -> str:
    """The page of the project's runs in MLflow, or its home as long as nothing was trained.

    From its list of experiments MLflow leads to pages for language models, whatever an experiment's kind.
    """
    url = f"{mlflow_url}/api/2.0/mlflow/experiments/get-by-name"
    answer = httpx.get(url, params={"experiment_name": EXPERIMENT}, timeout=5.0, trust_env=False)
    if answer.is_error:
        return mlflow_url
    return f"{mlflow_url}/#/experiments/{answer.json()['experiment']['experiment_id']}/runs?{MLFLOW_TRAINING}"


def free_ports(count: int) -> list[int]:
    """Different free loopback ports, chosen by the system."""
    sockets = [socket.create_server((HOST, 0)) for _ in range(count)]
    ports = [int(one.getsockname()[1]) for one in sockets]
    for one in sockets:
        one.close()
    return ports


def _socket(settings: Settings) -> Path:
    return settings.temp_folder / "supervisor.sock"


def _lock(settings: Settings) -> AbstractContextManager[None]:
    busy = "another command is starting or ending these services"
    return holding(
        settings.home / "run" / "lock", ServiceError(busy, remedy="wait for it, and run yours again")
    )


def _identifier(settings: Settings) -> str:
    ports = " ".join(f"{name}={port}" for name, port in settings.ports.items())
    return f"{ROOT} {ports}"


def _start_supervisord(settings: Settings) -> Any:
    environment = service_environment(settings) | {STACK: str(settings.home)}
    # Made once in a user's home folder, if it is not there.
    subprocess.run(
        [BIN / "ray", "get-auth-token", "--generate"], env=environment, capture_output=True, check=False
    )
    shutil.rmtree(settings.temp_folder, ignore_errors=True)
    try:
        # A folder that somebody else has made cannot be deleted, and is not used.
        settings.temp_folder.mkdir(mode=0o700)
    except OSError as error:
        raise ServiceStartError("there is no folder for sockets", got=str(error)) from error
    config = settings.home / "run" / "supervisord.conf"
    config.write_text(_configuration(settings), encoding="utf-8")
    done = subprocess.run(
        [BIN / "supervisord", "-c", config],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    until, server = time.monotonic() + SUPERVISORD_LIMIT_S, connect(settings)
    while server is None and done.returncode == 0 and time.monotonic() < until:
        time.sleep(POLL_S)
        server = connect(settings)
    if server is None:
        log = log_file(settings, "supervisord")
        raise ServiceStartError(
            "supervisord did not start", got=done.stderr.strip()[-500:], remedy=f"see {log}"
        )
    return server


def _configuration(settings: Settings) -> str:
    client, agent = free_ports(2)
    values = settings.model_dump() | {
        "bin": BIN,
        "identifier": _identifier(settings),
        "ray_agent_port": agent,
        "ray_client_port": client,
        "root": ROOT,
        "socket": _socket(settings),
        "temp_folder": settings.temp_folder,
    }
    template = Template(Path(__file__).with_name("supervisord.conf").read_text(encoding="utf-8"))
    # supervisord expands %(name)s in values.
    return template.substitute({name: str(value).replace("%", "%%") for name, value in values.items()})


def _require_free(settings: Settings, name: str) -> None:
    port = getattr(settings, f"{name}_port")
    with socket.socket() as client:
        client.settimeout(1.0)
        if client.connect_ex((HOST, port)) != 0:
            return
    raise PortTakenError(
        f"port {port} of {name} is taken",
        remedy=f"end its program (`ss -ltnp` lists them), or set CSPACE_{name.upper()}_PORT to another port",
    )


def _wait_healthy(settings: Settings, server: Any, name: str) -> None:
    pid, until, failure = server.getProcessInfo(name)["pid"], time.monotonic() + START_LIMIT_S, ""
    while not failure and not healthy(settings, name):
        info = server.getProcessInfo(name)
        if info["pid"] != pid or not _runs(info):
            failure = "ended while it was starting"
        elif time.monotonic() > until:
            failure = f"did not answer within {START_LIMIT_S:.0f} s"
        else:
            time.sleep(POLL_S)
    if failure:
        with suppress(xmlrpc.client.Fault):  # it has ended already
            server.stopProcess(name)
        log = log_file(settings, name)
        last = log.read_text(encoding="utf-8", errors="replace").splitlines()[-LOG_LINES:]
        remedy = "\n".join([f"the end of its log {log}:", *last, "then `make down` and start again"])
        raise ServiceStartError(f"{name} {failure}", remedy=remedy)


def _report_jobs(settings: Settings, report: Report) -> None:
    # Imported here: Ray takes a second.
    from ray.job_submission import JobSubmissionClient  # noqa: PLC0415

    with suppress(RuntimeError, OSError):  # a head that does not answer has no jobs to lose
        jobs = [
            job for job in JobSubmissionClient(settings.ray_url).list_jobs() if not job.status.is_terminal()
        ]
        if jobs:
            report("these jobs end with Ray; a training job goes on when it is submitted again:")
        for job in jobs:
            report(f"  {job.submission_id}: {job.entrypoint}")


def _runs(info: dict[str, Any]) -> bool:
    return info["state"] in RUNNING_STATES


def _is_alive(process: psutil.Process) -> bool:
    with suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False
