"""Settings of the services of one machine, its state folder, and the environment of jobs and shells."""

import hashlib
import json
import os
import re
import secrets
import shlex
import shutil
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import ConfigError, ServiceStartError, StorageError
from cspace.files import IGNORE_ALL, IGNORE_FILE, ignore, replacing, write_json
from services.outcomes import FOLDER as OUTCOMES
from services.planner.client import API_URL

MARKER = ".cspace-sampler.json"
# The path of a Unix socket ends at 103 bytes on macOS (107 on Linux), and Ray appends 64 to its folder.
MAX_TEMP_PATH = 38
# Ray starts its processes by a shell that is given their paths without quotes.
SHELL_SPECIAL = re.compile(r"""[][\s"'`$&;()<>|*?#\\:]""")


HOST = "127.0.0.1"
API_PORT = "CSPACE_API_PORT"
RAY_PORT = "CSPACE_RAY_PORT"
MLFLOW_PORT = "CSPACE_MLFLOW_PORT"
VIEWER_PORT = "CSPACE_VIEWER_PORT"
RAY_CPUS = "CSPACE_RAY_CPUS"
HOME = "CSPACE_HOME"
FOLDERS = ("mlflow", "data", "logs", "run", "figures", "models", "arms")

_ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True, slots=True)
class Settings:
    """Where the services of this machine keep their state and on which loopback ports they listen.

    Args:
        home: the state folder, absolute.
        root: the project's root: what jobs run in.
        api_port: of the inference API.
        ray_port: of Ray's dashboard and jobs API.
        mlflow_port: of the tracking server and its UI.
        viewer_port: of the 3D viewer.
        ray_cpus: what the Ray head offers to trials and tasks.
    """

    home: Path
    root: Path
    api_port: int = 8000
    ray_port: int = 8265
    mlflow_port: int = 5000
    viewer_port: int = 8090
    ray_cpus: int = 2

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ, root: Path = _ROOT) -> "Settings":
        """Read ``CSPACE_HOME`` and the ``CSPACE_*_PORT`` settings; an empty one counts as not set.

        Raises:
            ConfigError: a value is not what the setting takes.
        """
        settings = cls(
            home=_home(environment, root),
            root=root,
            api_port=_number(environment, API_PORT, 8000, 1, 65535),
            ray_port=_number(environment, RAY_PORT, 8265, 1, 65535),
            mlflow_port=_number(environment, MLFLOW_PORT, 5000, 1, 65535),
            viewer_port=_number(environment, VIEWER_PORT, 8090, 1, 65535),
            # The local trials run beside each other, so even one core offers two places.
            ray_cpus=_number(environment, RAY_CPUS, max(2, _cores()), 1, 1024),
        )
        settings.require_distinct_ports()
        return settings

    @property
    def data_folder(self) -> Path:
        """Data sets and what jobs keep between runs."""
        return self.home / "data"

    @property
    def outcomes_folder(self) -> Path:
        """What users reported of answers, until it is uploaded."""
        return self.data_folder / "outcomes"

    @property
    def logs_folder(self) -> Path:
        """One log file a service."""
        return self.home / "logs"

    @property
    def run_folder(self) -> Path:
        """Records of the running processes."""
        return self.home / "run"

    @property
    def arms_folder(self) -> Path:
        """Robots of the user's own, imported from their descriptions."""
        return self.home / "arms"

    @property
    def figures_folder(self) -> Path:
        """Pictures that the main job drew."""
        return self.home / "figures"

    @property
    def api_url(self) -> str:
        """Address of the inference API."""
        return f"http://{HOST}:{self.api_port}"

    @property
    def ray_url(self) -> str:
        """Address of Ray's dashboard and jobs API."""
        return f"http://{HOST}:{self.ray_port}"

    @property
    def mlflow_url(self) -> str:
        """Address of the tracking server and its UI."""
        return f"http://{HOST}:{self.mlflow_port}"

    @property
    def viewer_url(self) -> str:
        """Address of the 3D viewer."""
        return f"http://{HOST}:{self.viewer_port}"

    def make_folders(self) -> None:
        """Make the state folder, for this user alone, with its parts.

        Raises:
            ConfigError: it cannot be made, or is somebody else's.
        """
        try:
            claim(self.home)
            for name in FOLDERS:
                (self.home / name).mkdir(exist_ok=True)
        except OSError as error:
            raise ConfigError(
                "the state folder cannot be made", got=str(error), remedy=f"set {HOME} to a folder of yours"
            ) from error

    def require_distinct_ports(self) -> None:
        """Raise ConfigError where two services share a port."""
        names = {
            API_PORT: self.api_port,
            RAY_PORT: self.ray_port,
            MLFLOW_PORT: self.mlflow_port,
            VIEWER_PORT: self.viewer_port,
        }
        if len(set(names.values())) < len(names):
            raise ConfigError(
                "two services share a port",
                expected="a different port for each",
                got=", ".join(f"{name}={port}" for name, port in names.items()),
            )


def _home(environment: Mapping[str, str], root: Path) -> Path:
    user = Path(environment.get("HOME") or Path.home())
    state = Path(environment.get("XDG_STATE_HOME") or user / ".local" / "state")
    home = Path(environment.get(HOME) or state / "cspace-sampler").expanduser()
    if not home.is_absolute():
        raise _wrong(HOME, "an absolute folder", str(home))
    # `clean-state` deletes below this folder: it must be one that holds nothing else.
    if home in {user, root} or home in user.parents or home in root.parents:
        raise _wrong(HOME, "a folder of its own", str(home))
    if home.exists() and not home.is_dir():
        raise _wrong(HOME, "a folder", f"the file {home}")
    return home


def _number(environment: Mapping[str, str], name: str, default: int, low: int, high: int) -> int:
    text = environment.get(name) or str(default)
    number = int(text) if text.isascii() and text.isdecimal() else low - 1
    if not low <= number <= high:
        raise _wrong(name, f"a whole number from {low} to {high}", text)
    return number


def _wrong(name: str, expected: str, got: str) -> ConfigError:
    return ConfigError(
        f"the setting {name} is wrong",
        expected=expected,
        got=repr(got),
        remedy=f"set {name} in the environment, or unset it for its default",
    )


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def claim(home: Path) -> None:
    """Mark a folder as this project's, with the names of what it keeps there.

    A new or empty folder is marked and ignores itself.

    Raises:
        ConfigError: it holds something else.
        OSError: it cannot be made or written.
    """
    home.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not (home / MARKER).is_file():
        found = sorted(path.name for path in home.iterdir())
        if found:
            raise ConfigError(
                f"{home} is not a state folder of this project",
                expected="a new or an empty folder",
                got=", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else ""),
                remedy="set CSPACE_HOME to a folder of its own",
            )
        write_json(home / MARKER, {"made_by": "cspace-sampler", "parts": FOLDERS})
        ignore(home)


def owned(home: Path) -> tuple[str, ...]:
    """The parts that the mark lists; none where there is no folder.

    Raises:
        ConfigError: the folder is not this project's, or its mark is damaged.
    """
    if not home.is_dir():
        return ()
    try:
        listed = json.loads((home / MARKER).read_text(encoding="utf-8"))["parts"]
        return tuple(name for name in FOLDERS if name in listed)
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(
            f"{home} is not a state folder of this project",
            expected=f"{MARKER} in it, which `make up` writes",
            got=f"{type(error).__name__} on reading it",
            remedy="see what CSPACE_HOME says, or delete the folder yourself",
        ) from error


def size_bytes(folder: Path) -> int:
    """Sum over the files below a folder, 0 where there is none; links are not followed."""
    total = 0
    for path in folder.rglob("*"):
        try:
            total += path.lstat().st_size if not path.is_dir() else 0
        except OSError:  # deleted in between
            continue
    return total


def size_text(count: int) -> str:
    """A number of bytes for people."""
    size = float(count)
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.0f} {unit}"
        size /= 1000
    return f"{size:.1f} GB"


def state_parts(settings: Settings) -> dict[Path, int]:
    """What :func:`drop_state` would delete, with its size in bytes.

    Raises:
        ConfigError: the state folder is not this project's.
    """
    parts = [settings.home / name for name in owned(settings.home)]
    return {part: size_bytes(part) for part in [*parts, temp_folder(settings)] if part.is_dir()}


def drop_state(settings: Settings) -> None:
    """Delete the parts of the state folder, and the folder itself if nothing else lies in it.

    Raises:
        ConfigError: it is not this project's.
        StorageError: something cannot be deleted.
    """
    parts = state_parts(settings)
    try:
        for part in parts:
            shutil.rmtree(part)
        ignored = settings.home / IGNORE_FILE
        if ignored.is_file() and ignored.read_text(encoding="utf-8", errors="replace") == IGNORE_ALL:
            ignored.unlink()
        # Last, so that what was interrupted can be repeated.
        (settings.home / MARKER).unlink(missing_ok=True)
        if settings.home.is_dir() and not any(settings.home.iterdir()):
            settings.home.rmdir()
    except OSError as error:
        raise StorageError("the state folder cannot be deleted", got=str(error)) from error


def token_headers(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The header that carries the token; empty where there is none yet."""
    token = read_token(environment)
    return {} if token is None else {"Authorization": f"Bearer {token}"}


def read_token(environment: Mapping[str, str] = os.environ) -> str | None:
    """The token in Ray's own order: its variable, the file that a variable names, the file at home.

    Raises:
        ServiceStartError: the file cannot be read.
    """
    token = environment.get("RAY_AUTH_TOKEN", "").strip()
    if token:
        return token
    path = _token_path(environment)
    try:
        return path.read_text(encoding="utf-8").strip() or None
    except FileNotFoundError:
        return None
    except (OSError, UnicodeDecodeError) as error:
        raise ServiceStartError(f"Ray's token {path} cannot be read", got=str(error)) from error


def ensure_token(environment: Mapping[str, str] = os.environ) -> None:
    """Make a token, readable by this user alone, unless there is one.

    The same as `ray get-auth-token --generate`, without starting Ray's command line for it.

    Raises:
        ServiceStartError: it cannot be made.
    """
    if read_token(environment) is not None:
        return
    path = _token_path(environment)
    if environment.get("RAY_AUTH_TOKEN_PATH"):
        raise ServiceStartError(
            "the file that RAY_AUTH_TOKEN_PATH names holds no token",
            got=str(path),
            remedy="put one there, or unset the variable to have one made",
        )
    try:
        path.parent.mkdir(mode=0o700, exist_ok=True)
        with replacing(path) as beside:
            beside.touch(mode=0o600)
            beside.write_text(secrets.token_hex(32), encoding="utf-8")
    except OSError as error:
        raise ServiceStartError(f"Ray's token {path} cannot be made", got=str(error)) from error


def _token_path(environment: Mapping[str, str]) -> Path:
    named = environment.get("RAY_AUTH_TOKEN_PATH")
    return Path(named) if named else Path(environment.get("HOME") or Path.home()) / ".ray" / "auth_token"


_NO_PROXY = ("127.0.0.1", "localhost")
# What a user's shell says about other clusters and servers would lead jobs astray; his token is his.
_DROPPED = ("RAY_", "MLFLOW_", "PYTHONHOME")
_KEPT = ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH")


def service_environment(settings: Settings, base: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of the services, which the Ray head hands on to its jobs."""
    kept = {name: value for name, value in base.items() if name in _KEPT or not name.startswith(_DROPPED)}
    return without_proxy(kept) | {
        "CSPACE_DATA_DIR": str(settings.data_folder),
        # Jobs that run from an uploaded copy of the sources, without history, tell their commit by this.
        "CSPACE_GIT_DIR": str(settings.root / ".git"),
        "CSPACE_MODEL_CACHE": str(settings.home / "models"),
        # Empty switches it off; another folder would be that of another state folder.
        OUTCOMES: "" if base.get(OUTCOMES) == "" else str(settings.outcomes_folder),
        **_mlflow_environment(settings),
        "OMP_NUM_THREADS": "1",
        # onnxruntime reports on its use from the import on, unless told not to.
        "ORT_DISABLE_TELEMETRY": "1",
        "PATH": _path(base),
        "PYTHONPATH": str(settings.root),
        "PYTHONUNBUFFERED": "1",
        "RAY_AUTH_MODE": "token",
        # Trials say the same of themselves, and each line counts.
        "RAY_DEDUP_LOGS": "0",
        # `ray job stop` gives a job this long to write its checkpoints.
        "RAY_JOB_STOP_WAIT_TIME_S": "20",
        # Without this, Ray takes 127.0.0.1 for the machine's outer address and listens there. The switch is
        # named after the systems on which a head keeps to the loopback address by default.
        "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
        "RAY_USAGE_STATS_ENABLED": "0",
    }


def _mlflow_environment(settings: Settings) -> dict[str, str]:
    return {
        "MLFLOW_TRACKING_URI": settings.mlflow_url,
        "MLFLOW_DISABLE_TELEMETRY": "true",
        # Progress bars and addresses turn a log into noise.
        "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
        "MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT": "true",
    }


def without_proxy(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment with loopback addresses excepted from every proxy."""
    changed = dict(environment)
    for name in ("NO_PROXY", "no_proxy"):
        listed = [part for part in environment.get(name, "").split(",") if part]
        changed[name] = ",".join(listed + [host for host in _NO_PROXY if host not in listed])
    return changed


def shell_lines(settings: Settings) -> list[str]:
    """Lines that set a shell up for `ray job submit` and the project's commands."""
    values = {
        "RAY_AUTH_MODE": "token",
        "RAY_ADDRESS": settings.ray_url,
        "RAY_JOB_SUBMIT_HOOK": "services.local.upload.check_upload",
        API_URL: settings.api_url,
        OUTCOMES: str(settings.outcomes_folder),
        **_mlflow_environment(settings),
    }
    lines = [f"export {name}={shlex.quote(value)}" for name, value in values.items()]
    return [*lines, f'export PATH={shlex.quote(str(binaries()))}:"$PATH"']


def binaries() -> Path:
    """The folder of the environment's programs."""
    return Path(sys.executable).parent


def _path(base: Mapping[str, str]) -> str:
    return os.pathsep.join([str(binaries()), base.get("PATH") or os.defpath])


def temp_folder(settings: Settings) -> Path:
    """Ray's folder for sockets and session logs: short, and different for each state folder."""
    name = f"cspace-{os.getuid()}-{hashlib.sha256(os.fsencode(settings.home)).hexdigest()[:8]}"
    preferred = Path(tempfile.gettempdir()) / name
    # Ray fails on the length of a socket's path, and on a space in it.
    fits = len(os.fsencode(preferred)) <= MAX_TEMP_PATH and not SHELL_SPECIAL.search(str(preferred))
    return preferred if fits else Path("/tmp") / name  # noqa: S108
