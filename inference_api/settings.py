"""Settings of the inference API, read from the environment once, at the edge."""

import ipaddress
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path

from cspace.errors import ConfigError
from services.outcomes import FOLDER
from services.registry.ports import PRETRAINED, SHIPPED, is_model_name, is_shipped

TRACES_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
# The name is the metrics library's; `--workers` sets it.
METRICS_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
THREADS = "CSPACE_API_THREADS"
HOSTS = "CSPACE_API_HOSTS"
WORKBENCH = "CSPACE_API_WORKBENCH"
ANY = "*"
MIB = 1024 * 1024
_HOST = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*|\[[0-9A-Fa-f:.]+\]", re.ASCII)
_ORIGIN = re.compile(r"https?://(?:[A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\])(?::[0-9]{1,5})?", re.ASCII)
DEFAULT_MODEL = "cspace-sampler"
PRETRAINED_FOLDER = Path(__file__).parent / "pretrained"
# Where `make docs` of a checkout builds it.
GUIDE_FOLDER = Path(__file__).parents[1] / "build" / "docs"


def usable_cores() -> int:
    """The cores that this process may run on, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, slots=True)
class Protection:
    """Who may ask, and how much.

    Args:
        keys_file: of API keys, see :mod:`inference_api.keys`; None lets everybody in.
        max_in_flight: requests that are answered at the same time, at least 1; further ones are refused.
        body_timeout_s: within which a request's body has to arrive, above 0.
        rate_per_s: requests a second and client that are allowed in the long run; 0 for no limit.
        rate_burst: how many a client may send at once before that counts, at least 1.
        held_body_bytes: of all bodies that have arrived and are not answered, above the largest body.
        hosts: names under which the server answers, besides those of loopback; ``*`` for any.
        origins: of other sites whose pages may use the server, as ``https://host:port``.
        trusted_proxies: addresses and networks whose ``X-Forwarded-For`` and ``-Proto`` are believed.
    """

    keys_file: Path | None = None
    max_in_flight: int = 64
    body_timeout_s: float = 30.0
    rate_per_s: float = 0.0
    rate_burst: int = 20
    held_body_bytes: int = 64 * 1024 * 1024
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()
    trusted_proxies: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ConnectionLimits:
    """What one connection may take, and how many there may be.

    Args:
        connections: open at the same time, at least 1.
        header_timeout_s: from a request's first byte to the end of its headers, above 0; for the first
            request from the connection on.
        write_timeout_s: for an answer that the client does not read, above 0.
    """

    connections: int = 512
    header_timeout_s: float = 10.0
    write_timeout_s: float = 10.0


@dataclass(frozen=True, slots=True)
class ApiSettings:
    """Everything that can be set.

    Args:
        registry_uri: address of the MLflow server; None serves the shipped model only.
        cache_folder: where downloaded bundles are kept.
        model_name: the registered model whose champion is the default.
        poll_s: time between two looks at the champion's alias, above 0.
        pretrained_folder: the shipped bundle.
        loaded_bundles: how many bundles beside champion and shipped one stay in memory, at least 1.
        cached_pictures: how many encoded pictures stay in memory; 0 for none.
        threads: how many requests one process computes at the same time, at least 1.
        metrics_folder: where the processes of one server keep their metrics; None for a single process.
        protection: who may ask, and how much.
        traces: whether spans are sent, by OpenTelemetry's own variables.
        stored_bundles: how many versions of each model stay on disk beside its champion, at least 1.
        connections: bounds on connections.
        grace_s: for requests in flight when the server is told to end, in whole s, at least 1.
        further_folders: shipped bundles of other robots, by name.
        guide_folder: the built documentation site, which need not be there.
        workbench: whether the page at ``/`` may ask for the truth of scenes.
        mlflow_pages: where browsers find MLflow's pages, for links; None for no links.
        load_planner: whether the search of plans is loaded before the server is ready.
        outcomes_folder: where outcomes wait for their upload; None keeps none.
        outcomes_bytes: of that folder, at least 16 MiB.
        trusted_key: of whose owner registered bundles have to be signed, PEM file; None for any.
    """

    registry_uri: str | None
    cache_folder: Path
    model_name: str = DEFAULT_MODEL
    poll_s: float = 2.0
    pretrained_folder: Path = PRETRAINED_FOLDER
    loaded_bundles: int = 4
    cached_pictures: int = 256
    threads: int = field(default_factory=usable_cores)
    metrics_folder: Path | None = None
    protection: Protection = field(default_factory=Protection)
    traces: bool = False
    stored_bundles: int = 20
    connections: ConnectionLimits = field(default_factory=ConnectionLimits)
    grace_s: int = 10
    further_folders: Mapping[str, Path] = field(default_factory=dict)
    guide_folder: Path = GUIDE_FOLDER
    workbench: bool = False
    mlflow_pages: str | None = None
    load_planner: bool = True
    outcomes_folder: Path | None = None
    outcomes_bytes: int = 256 * MIB
    trusted_key: Path | None = None

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] | None = None) -> "ApiSettings":
        """Read ``MLFLOW_TRACKING_URI`` and the ``CSPACE_*`` settings of the API.

        Raises:
            ConfigError: a value is not what the setting takes.
        """
        values = os.environ if environment is None else environment
        cache = Path(values.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cspace-sampler" / "models"
        own = values.get("CSPACE_PRETRAINED_MODEL")
        return cls(
            registry_uri=values.get("MLFLOW_TRACKING_URI") or None,
            cache_folder=Path(values.get("CSPACE_MODEL_CACHE") or cache),
            model_name=_served_name(values.get("CSPACE_MODEL_NAME") or DEFAULT_MODEL),
            poll_s=_number(values, "CSPACE_MODEL_POLL_S", 2.0, 0.01),
            pretrained_folder=Path(own or PRETRAINED_FOLDER),
            loaded_bundles=int(_number(values, "CSPACE_LOADED_MODELS", 4, 1)),
            cached_pictures=int(_number(values, "CSPACE_CACHED_PICTURES", 256, 0)),
            threads=int(_number(values, THREADS, usable_cores(), 1)),
            metrics_folder=Path(values[METRICS_FOLDER]) if values.get(METRICS_FOLDER) else None,
            protection=_protection(values),
            traces=wants_traces(values),
            stored_bundles=int(_number(values, "CSPACE_STORED_MODELS", 20, 1)),
            connections=ConnectionLimits(
                connections=int(_number(values, "CSPACE_API_MAX_CONNECTIONS", 512, 1)),
                header_timeout_s=_number(values, "CSPACE_API_HEADER_TIMEOUT_S", 10.0, 0.01),
                write_timeout_s=_number(values, "CSPACE_API_WRITE_TIMEOUT_S", 10.0, 0.01),
            ),
            grace_s=int(_number(values, "CSPACE_API_GRACE_S", 10, 1)),
            further_folders={} if own else further_folders(),
            guide_folder=Path(values.get("CSPACE_API_GUIDE") or GUIDE_FOLDER),
            workbench=_switch(values, WORKBENCH),
            mlflow_pages=_pages(values, "CSPACE_API_MLFLOW_PAGES"),
            load_planner=_switch(values, "CSPACE_API_LOAD_PLANNER", "1"),
            outcomes_folder=Path(values[FOLDER]) if values.get(FOLDER) else None,
            outcomes_bytes=int(MIB * _number(values, "CSPACE_OUTCOMES_MIB", 256, 16)),
            trusted_key=_trusted_key(values.get("CSPACE_TRUSTED_KEY", "")),
        )


def further_folders() -> dict[str, Path]:
    """Shipped bundles beside the default robot's, by name; those whose folders are there."""
    beside = {name: PRETRAINED_FOLDER.with_name(folder) for name, folder in SHIPPED.items()}
    return {name: folder for name, folder in beside.items() if name != PRETRAINED and folder.is_dir()}


def _trusted_key(text: str) -> Path | None:
    if not text:
        return None
    if not Path(text).is_file() or find_spec("model_signing") is None:
        raise ConfigError(
            "the setting CSPACE_TRUSTED_KEY is wrong",
            expected="a PEM file with a public key, and the extra signing installed",
            got=repr(text)[:200],
        )
    return Path(text)


def _served_name(text: str) -> str:
    if not is_model_name(text) or is_shipped(text):
        raise ConfigError(
            "the setting CSPACE_MODEL_NAME is wrong",
            expected="1 to 100 letters, digits, '.', '_' and '-', first a letter or digit; no shipped one's",
            got=repr(text)[:200],
            remedy="name a registered model, or unset it",
        )
    return text


def _protection(values: Mapping[str, str]) -> Protection:
    keys_file = values.get("CSPACE_API_KEYS_FILE")
    return Protection(
        keys_file=Path(keys_file) if keys_file else None,
        max_in_flight=int(_number(values, "CSPACE_API_MAX_IN_FLIGHT", 64, 1)),
        body_timeout_s=_number(values, "CSPACE_API_BODY_TIMEOUT_S", 30.0, 0.01),
        rate_per_s=_number(values, "CSPACE_API_RATE", 0.0, 0.0),
        rate_burst=int(_number(values, "CSPACE_API_BURST", 20, 1)),
        # Less would refuse bodies that are not too large.
        held_body_bytes=int(MIB * _number(values, "CSPACE_API_HELD_BODIES_MIB", 64, 8)),
        hosts=host_names(values.get(HOSTS, "")),
        origins=origins(values.get("CSPACE_API_ORIGINS", "")),
        trusted_proxies=proxies(values.get("CSPACE_API_TRUSTED_PROXIES", "")),
    )


def _number(values: Mapping[str, str], name: str, default: float, low: float) -> float:
    text = values.get(name) or str(default)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not low <= number < math.inf:
        raise ConfigError(
            f"the setting {name} is wrong",
            expected=f"a number, at least {low:g}",
            got=repr(text),
            remedy=f"set {name} in the environment, or unset it for {default:g}",
        )
    return number


def _switch(values: Mapping[str, str], name: str, default: str = "0") -> bool:
    text = values.get(name) or default
    if text not in ("0", "1"):
        raise ConfigError(f"the setting {name} is wrong", expected="0 or 1", got=repr(text)[:200])
    return text == "1"


def _pages(values: Mapping[str, str], name: str) -> str | None:
    text = values.get(name) or None
    if text is not None and not text.startswith(("http://", "https://")):
        raise ConfigError(
            f"the setting {name} is wrong", expected="an http or https address", got=repr(text)[:200]
        )
    return None if text is None else text.rstrip("/")


def host_names(text: str) -> tuple[str, ...]:
    """Names and addresses without ports, those of IPv6 in brackets as in a Host header; ``*`` is any.

    Raises:
        ConfigError: something else stands there.
    """
    names = tuple(bracketed(name) for name in _parts(text))
    for name in names:
        if name != ANY and not _HOST.fullmatch(name):
            raise _wrong("CSPACE_API_HOSTS", "names or addresses without ports, or *", name)
    return names


def origins(text: str) -> tuple[str, ...]:
    """Origins as browsers send them.

    Raises:
        ConfigError: something else stands there.
    """
    found = tuple(_parts(text))
    for origin in found:
        if not _ORIGIN.fullmatch(origin):
            raise _wrong("CSPACE_API_ORIGINS", "origins such as https://site.example:8443", origin)
    return found


def proxies(text: str) -> tuple[str, ...]:
    """Addresses and networks.

    Raises:
        ConfigError: something else stands there; ``*`` too, for it would believe everybody.
    """
    found = tuple(_parts(text))
    for proxy in found:
        try:
            ipaddress.ip_network(proxy)
        except ValueError as error:
            expected = "addresses or networks such as 10.0.0.0/8"
            raise _wrong("CSPACE_API_TRUSTED_PROXIES", expected, proxy) from error
    return found


def bracketed(host: str) -> str:
    """A host as it stands in a Host header: an address of IPv6 in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") and host.count(":") > 1 else host


def is_wildcard(host: str) -> bool:
    """Whether a server there listens on all addresses, so that it has no name of its own."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return host == ""


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _wrong(name: str, expected: str, got: str) -> ConfigError:
    return ConfigError(
        f"the setting {name} is wrong",
        expected=expected,
        got=repr(got),
        remedy=f"set {name} in the environment, separated by commas, or unset it",
    )


def wants_traces(environment: Mapping[str, str]) -> bool:
    """Whether OpenTelemetry's variables name a place to send traces to."""
    disabled = environment.get("OTEL_SDK_DISABLED", "").strip().lower() == "true"
    return not disabled and any(environment.get(name) for name in TRACES_ENDPOINTS)
