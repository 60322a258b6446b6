"""The services of this machine together: MLflow, Ray head and API; up, down and status."""

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ServiceError, ServiceStartError
from services.evaluator.tables import aligned
from services.local.processes import (
    Record,
    Service,
    answer_of,
    answers,
    drop_record,
    exclusive,
    family,
    free_ports,
    is_alive,
    problem_at,
    read_record,
    require_free,
    start_detached,
    stop,
    with_children,
    write_record,
)
from services.local.settings import (
    API_PORT,
    HOME,
    HOST,
    MLFLOW_PORT,
    RAY_PORT,
    SHELL_SPECIAL,
    VIEWER_PORT,
    Settings,
    binaries,
    ensure_token,
    service_environment,
    shell_lines,
    size_bytes,
    size_text,
    temp_folder,
    token_headers,
)
from services.names import EXPERIMENT, MLFLOW_TRAINING

_UNDER_WAY = {"PENDING", "RUNNING"}


def jobs_under_way(url: str, headers: Mapping[str, str]) -> tuple[str, ...]:
    """Submitted jobs that have not ended, in lines; none where there is none or the head does not answer.

    Args:
        url: of the jobs API.
        headers: with the token.
    """
    try:
        listed = json.loads(answer_of(f"{url}/api/jobs/", headers) or "[]")
        found = [job for job in listed if job["submission_id"] and job["status"] in _UNDER_WAY]
        lines = [
            f"  {job['submission_id']}, since {_moment(job['start_time'])}: {job['entrypoint']}"
            for job in found
        ]
    except (ValueError, LookupError, TypeError):
        return ()
    if not lines:
        return ()
    return ("these jobs end with Ray; a training job goes on when it is submitted again:", *lines)


def _moment(start_ms: float | None) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime((start_ms or 0) / 1000))


OBJECT_STORE_BYTES = 500_000_000


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


def _prepare(settings: Settings, environment: dict[str, str]) -> None:
    for used in (settings.root, binaries()):
        if SHELL_SPECIAL.search(str(used)):
            raise ServiceStartError(
                f"Ray cannot run below the folder '{used}'",
                expected="a path without spaces and characters of the shell",
                remedy="move the project, delete its .venv, and run make there",
            )
    folder = temp_folder(settings)
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.is_symlink() or folder.stat().st_uid != os.getuid():
        raise ServiceStartError(
            f"{folder} belongs to somebody else", remedy="set TMPDIR to a folder of yours with a short path"
        )
    # The last session's logs may still be wanted.
    sessions = [path for path in folder.glob("session_*") if path.is_dir() and not path.is_symlink()]
    for path in sorted(sessions)[:-1]:
        shutil.rmtree(path, ignore_errors=True)
    ensure_token(environment)


def mlflow_server(settings: Settings) -> Service:
    """MLflow on loopback. Its guard against DNS rebinding lets local names through by default."""
    folder = settings.home / "mlflow"
    # The job runner is for features that are not used here and costs eight processes.
    environment = service_environment(settings) | {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    del environment["MLFLOW_TRACKING_URI"]
    return Service(
        name="mlflow",
        title="MLflow",
        address=settings.mlflow_url,
        port=settings.mlflow_port,
        setting=MLFLOW_PORT,
        command=lambda: (
            str(binaries() / "mlflow"),
            "server",
            f"--host={HOST}",
            f"--port={settings.mlflow_port}",
            "--workers=1",
            f"--backend-store-uri=sqlite:///{folder / 'mlflow.db'}",
            f"--artifacts-destination={folder / 'artifacts'}",
            "--serve-artifacts",
            # The API asks for the champion every other second, and the log would never end.
            "--uvicorn-opts=--no-access-log",
        ),
        environment=environment,
        folder=folder,
        ready=lambda: answers(f"{settings.mlflow_url}/health"),
        start_limit_s=180.0,
        stop_grace_s=10.0,
    )


def api_server(settings: Settings) -> Service:
    """``python -m inference_api``; it answers before the registry does and looks for champions by itself.

    On a machine of one's own its page tells the truth of scenes, and links to MLflow.
    """
    return Service(
        name="api",
        title="inference API",
        address=settings.api_url,
        port=settings.api_port,
        setting=API_PORT,
        command=lambda: (
            sys.executable,
            "-m",
            "inference_api",
            f"--host={HOST}",
            f"--port={settings.api_port}",
        ),
        environment={
            **service_environment(settings),
            "CSPACE_API_WORKBENCH": "1",
            "CSPACE_API_MLFLOW_PAGES": settings.mlflow_url,
        },
        folder=settings.root,
        # Without any model it is not ready either, and stays so until one is trained.
        ready=lambda: (
            answers(f"{settings.api_url}/health/live")
            and not problem_at(f"{settings.api_url}/health/ready").endswith(":starting")
        ),
        start_limit_s=120.0,
        stop_grace_s=12.0,
    )


def viewer(settings: Settings) -> Service:
    """``python -m services.planner.viewer``: the arm among obstacles in 3D, on what the API answers."""
    return Service(
        name="viewer",
        title="viewer",
        address=settings.viewer_url,
        port=settings.viewer_port,
        setting=VIEWER_PORT,
        command=lambda: (
            sys.executable,
            "-m",
            "services.planner.viewer",
            f"--api={settings.api_url}",
            f"--port={settings.viewer_port}",
        ),
        environment=service_environment(settings),
        folder=settings.root,
        ready=lambda: answers(settings.viewer_url),
        start_limit_s=120.0,
        stop_grace_s=5.0,
    )


Report = Callable[[str], None]
POLL_S = 0.2
LOG_LINES = 25


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """One service as it is now; ``pid`` and ``since`` (Unix time in s) are None where it does not run."""

    title: str
    address: str
    pid: int | None
    since: float | None
    healthy: bool

    @property
    def running(self) -> bool:
        """Whether its process runs."""
        return self.pid is not None


def services(settings: Settings) -> tuple[Service, ...]:
    """All services in the order in which they are started; they end in the reverse."""
    return (mlflow_server(settings), ray_head(settings), api_server(settings))


def started_here(settings: Settings) -> tuple[Service, ...]:
    """The services, and the viewer where the demo has started it."""
    seen = viewer(settings)
    extra = (seen,) if read_record(settings.run_folder, seen.name) else ()
    return (*services(settings), *extra)


def up(settings: Settings, wanted: Sequence[Service], report: Report) -> None:
    """Start what does not run, all beside each other, and wait until everything is ready.

    Raises:
        PortTakenError: a stranger listens on a port; nothing was started.
        ServiceError: the services belong to another checkout or to other settings.
        ServiceStartError: one did not come up; it was ended again, the others go on.
    """
    settings.make_folders()
    with exclusive(settings.run_folder):
        began = time.monotonic()
        absent = [service for service in wanted if not _runs(settings, service)]
        for service in absent:
            # What a killed service left behind would hold its ports.
            record = read_record(settings.run_folder, service.name)
            if record is not None:
                _end(settings, service, record)
            require_free(service.port, service.title, service.setting)
        for service in absent:
            service.prepare()
        for service in absent:
            _start(settings, service)
            report(f"{service.title}: starting, log {_log(settings, service)}")
        for service in wanted:
            record = _wait(settings, service)
            write_record(settings.run_folder, with_children(record))
            state = f"ready after {time.monotonic() - began:.1f} s" if service in absent else "runs already"
            report(f"{service.title}: {state}, {service.address}")


def down(settings: Settings, wanted: Sequence[Service], report: Report) -> int:
    """End what was started here, by process id; how many services ran. What that interrupts is told first.

    Raises:
        ServiceError: a service belongs to another checkout; nothing was ended.
    """
    if not settings.run_folder.is_dir():
        return 0
    ended = 0
    with exclusive(settings.run_folder):
        found = [(service, read_record(settings.run_folder, service.name)) for service in reversed(wanted)]
        records = [(service, record) for service, record in found if record is not None]
        for service, record in records:
            if Path(record.root).is_dir() and (is_alive(record) or family(record)):
                _require_own(settings, service, record)
        for service, record in records:
            if is_alive(record) and record.address == service.address:
                for line in service.interrupts():
                    report(line)
        for service, record in records:
            ended += is_alive(record)
            count = _end(settings, service, record)
            report(f"{service.title}: ended" if count else f"{service.title}: had ended before")
    return ended


def status(settings: Settings, wanted: Sequence[Service]) -> list[ServiceStatus]:
    """What each service is doing."""
    return [_status(service, read_record(settings.run_folder, service.name)) for service in wanted]


def require_down(settings: Settings, wanted: Sequence[Service]) -> None:
    """Raise ServiceError where a service or something that it started still runs."""
    records = [read_record(settings.run_folder, service.name) for service in wanted]
    alive = [record.service for record in records if record and (is_alive(record) or family(record))]
    if alive:
        raise ServiceError("services still run", got=", ".join(alive), remedy="`make down` first")


def _status(service: Service, record: Record | None) -> ServiceStatus:
    if record is None or not is_alive(record):
        return ServiceStatus(service.title, service.address, None, None, healthy=False)
    # A service that was started on another port is asked there.
    healthy = record.address == service.address and service.ready()
    return ServiceStatus(service.title, record.address, record.pid, record.create_time, healthy)


def _runs(settings: Settings, service: Service) -> bool:
    record = read_record(settings.run_folder, service.name)
    if record is None or not is_alive(record):
        return False
    _require_own(settings, service, record)
    if record.address != service.address:
        raise ServiceError(
            f"{service.title} runs at another address",
            expected=service.address,
            got=record.address,
            remedy=f"`make down` first, or set {service.setting} to the port that is in use",
        )
    return True


def _require_own(settings: Settings, service: Service, record: Record) -> None:
    if Path(record.root) != settings.root:
        raise ServiceError(
            f"{service.title} runs from another checkout",
            expected=str(settings.root),
            got=record.root,
            remedy=f"`make down` there, or set {HOME} and the ports to others for this checkout",
        )


def _end(settings: Settings, service: Service, record: Record) -> int:
    """End a service and forget it; how many processes that were."""
    count = stop(record, service.stop_grace_s)
    drop_record(settings.run_folder, service.name)
    return count


def _start(settings: Settings, service: Service) -> None:
    record = start_detached(
        service.name,
        service.command(),
        environment=service.environment,
        folder=service.folder,
        log=_log(settings, service),
        root=settings.root,
        address=service.address,
    )
    write_record(settings.run_folder, record)


def _wait(settings: Settings, service: Service) -> Record:
    """Wait until a service is ready; one that ends, or takes too long, is ended."""
    record = read_record(settings.run_folder, service.name)
    if record is None:
        raise ServiceError(f"the record of {service.title} is gone", remedy="`make down`, then `make up`")
    until, failure = time.monotonic() + service.start_limit_s, None
    while failure is None and not service.ready():
        if not is_alive(record):
            failure = "ended while it was starting"
        elif time.monotonic() > until:
            failure = f"did not answer within {service.start_limit_s:.0f} s"
        else:
            time.sleep(POLL_S)
    if failure is None:
        return record
    _end(settings, service, record)
    log = Path(record.log)
    last = log.read_text(encoding="utf-8", errors="replace").splitlines()[-LOG_LINES:]
    raise ServiceStartError(
        f"{service.title} {failure}",
        remedy="\n".join([f"the end of its log {log}:", *last, "then `make down` and start again"]),
    )


def _log(settings: Settings, service: Service) -> Path:
    return settings.logs_folder / f"{service.name}.log"


def experiment_address(mlflow_url: str) -> str:
    """The page of the project's runs in MLflow, or its home as long as nothing was trained.

    From its list of experiments MLflow leads to pages for language models, whatever an experiment's kind.
    """
    found = answer_of(f"{mlflow_url}/api/2.0/mlflow/experiments/get-by-name?experiment_name={EXPERIMENT}")
    if found is None:
        return mlflow_url
    number = json.loads(found)["experiment"]["experiment_id"]
    return f"{mlflow_url}/#/experiments/{number}/runs?{MLFLOW_TRAINING}"


def addresses(settings: Settings) -> str:
    """Where to look."""
    return "\n".join(
        [
            f"MLflow UI       {experiment_address(settings.mlflow_url)}",
            f"Ray dashboard   {settings.ray_url}  (asks for the token: `ray get-auth-token` prints it)",
            f"API             {settings.api_url}/docs",
            f"workbench       {settings.api_url}/",
        ]
    )


def shell_help(settings: Settings) -> str:
    """How to set a shell up for jobs of one's own."""
    return "\n".join(
        [
            "A shell for `ray job submit training/cluster_train.py` needs these lines",
            '(`eval "$(.venv/bin/python -m services.local env)"` runs them):',
            *(f"  {line}" for line in shell_lines(settings)),
        ]
    )


def status_table(settings: Settings, statuses: Sequence[ServiceStatus]) -> str:
    """One line a service, then the state folder."""
    rows = [("service", "state", "pid", "since", "address")]
    for one in statuses:
        state = ("healthy" if one.healthy else "does not answer") if one.running else "not running"
        since = "-" if one.since is None else time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(one.since))
        rows.append((one.title, state, str(one.pid or "-"), since, one.address))
    folder = f"state folder {settings.home}, {size_text(size_bytes(settings.home))}"
    return f"{aligned(rows)}\n{folder}"
