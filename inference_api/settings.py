"""Settings of the inference API, read from the environment once, at the edge."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cspace.errors import ConfigError
from inference_api.connections.limits import MIB, ConnectionLimits
from inference_api.guards.names import host_names, origins, proxies
from inference_api.guards.protection import Protection
from inference_api.telemetry.tracing import wants_traces
from services.registry.references import PRETRAINED, SHIPPED, is_model_name, is_shipped

# The name is the metrics library's; `--workers` sets it.
METRICS_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
THREADS = "CSPACE_API_THREADS"
HOSTS = "CSPACE_API_HOSTS"
WORKBENCH = "CSPACE_API_WORKBENCH"
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
        )


def further_folders() -> dict[str, Path]:
    """Shipped bundles beside the default robot's, by name; those whose folders are there."""
    beside = {name: PRETRAINED_FOLDER.with_name(folder) for name, folder in SHIPPED.items()}
    return {name: folder for name, folder in beside.items() if name != PRETRAINED and folder.is_dir()}


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
