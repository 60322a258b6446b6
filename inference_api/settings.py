"""Settings of the inference API, read from the environment once, at the edge."""

import ipaddress
import os
import re
from collections.abc import Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from cspace.errors import ConfigError
from cspace.strict_json import refused
from services.outcomes import FOLDER
from services.registry.entities import PRETRAINED, SHIPPED, is_model_name, is_shipped

TRACES_ENDPOINTS = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")
# The name is the metrics library's; `--workers` sets it.
METRICS_FOLDER = "PROMETHEUS_MULTIPROC_DIR"
CACHE_FOLDER = "CSPACE_MODEL_CACHE"
PRETRAINED_MODEL = "CSPACE_PRETRAINED_MODEL"
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


def bracketed(host: str) -> str:
    """A host as it stands in a Host header: an address of IPv6 in brackets."""
    return f"[{host}]" if ":" in host and not host.startswith("[") and host.count(":") > 1 else host


def is_wildcard(host: str) -> bool:
    """Whether a server there listens on all addresses, so that it has no name of its own."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return host == ""


def wants_traces(environment: Mapping[str, str]) -> bool:
    """Whether OpenTelemetry's variables name a place to send traces to."""
    disabled = environment.get("OTEL_SDK_DISABLED", "").strip().lower() == "true"
    return not disabled and any(environment.get(name) for name in TRACES_ENDPOINTS)


def further_folders() -> dict[str, Path]:
    """Shipped bundles beside the default robot's, by name; those whose folders are there."""
    beside = {name: PRETRAINED_FOLDER.with_name(folder) for name, folder in SHIPPED.items()}
    return {name: folder for name, folder in beside.items() if name != PRETRAINED and folder.is_dir()}


# What the validators raise is what an error says of the expected value.


def _parts(value: object) -> object:
    """The entries of a text, which commas separate."""
    if not isinstance(value, str):
        return value
    return tuple(part.strip() for part in value.split(",") if part.strip())


def _host(text: str) -> str:
    name = bracketed(text)
    if name != ANY and not _HOST.fullmatch(name):
        raise ValueError("names or addresses without ports, or *, separated by commas")
    return name


def _origin(text: str) -> str:
    if not _ORIGIN.fullmatch(text):
        raise ValueError("origins such as https://site.example:8443, separated by commas")
    return text


def _network(text: str) -> str:
    try:
        ipaddress.ip_network(text)
    except ValueError as error:
        # ``*`` too, for it would believe everybody.
        raise ValueError("addresses or networks such as 10.0.0.0/8, separated by commas") from error
    return text


def _bytes_of_mib(least_mib: int, value: object) -> object:
    """A text is a number of MiB; other values are in bytes already."""
    if not isinstance(value, str):
        return value
    try:
        size = int(MIB * float(value))
    except (ValueError, OverflowError):
        size = 0
    if size < MIB * least_mib:
        raise ValueError(f"a number of MiB, at least {least_mib}")
    return size


def _switch(value: object) -> object:
    if value not in ("0", "1", True, False):
        raise ValueError("0 or 1")
    return value


def _served_name(text: str) -> str:
    if not is_model_name(text) or is_shipped(text):
        raise ValueError(
            "a registered model: 1 to 100 letters, digits, '.', '_' and '-', first a letter or digit; no "
            "shipped one's name"
        )
    return text


def _pages(text: str) -> str:
    if not text.startswith(("http://", "https://")):
        raise ValueError("an http or https address")
    return text.rstrip("/")


def _trusted_key(path: Path) -> Path:
    if not path.is_file() or find_spec("model_signing") is None:
        raise ValueError("a PEM file with a public key, and the extra signing installed")
    return path


_Switch = Annotated[bool, BeforeValidator(_switch)]
_Hosts = Annotated[tuple[Annotated[str, AfterValidator(_host)], ...], BeforeValidator(_parts)]
_Origins = Annotated[tuple[Annotated[str, AfterValidator(_origin)], ...], BeforeValidator(_parts)]
_Networks = Annotated[tuple[Annotated[str, AfterValidator(_network)], ...], BeforeValidator(_parts)]
_KeyFile = Annotated[Path, AfterValidator(_trusted_key)]
_BytesOf8MiB = Annotated[int, BeforeValidator(partial(_bytes_of_mib, 8))]
_BytesOf16MiB = Annotated[int, BeforeValidator(partial(_bytes_of_mib, 16))]


class _Settings(BaseModel):
    """Settings whose aliases are the names of environment variables."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        populate_by_name=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )

    @classmethod
    def read(cls, environment: Mapping[str, str], **others: Any) -> Self:
        """The settings of an environment; an empty value counts as unset.

        Args:
            environment: texts by name of the variable.
            others: values of fields that no variable has.

        Raises:
            ConfigError: a value is not what its setting takes.
        """
        names = {one.alias for one in cls.model_fields.values()}
        given = {name: text for name, text in environment.items() if text and name in names}
        try:
            return cls.model_validate({**given, **others})
        except ValidationError as error:
            remedy = "set it in the environment, or unset it for its default"
            raise refused(error, ConfigError, "a setting", remedy) from error


class Protection(_Settings):
    """Who may ask, and how much."""

    keys_file: Path | None = Field(None, alias="CSPACE_API_KEYS_FILE")
    """File of API keys; without it everybody may ask."""
    max_in_flight: int = Field(64, ge=1, alias="CSPACE_API_MAX_IN_FLIGHT")
    """Requests that are answered at the same time; further ones are refused."""
    body_timeout_s: float = Field(30.0, gt=0.0, alias="CSPACE_API_BODY_TIMEOUT_S")
    """Time within which a request's body has to arrive, s."""
    rate_per_s: float = Field(0.0, ge=0.0, alias="CSPACE_API_RATE")
    """Requests a second and client that are allowed in the long run; 0 for no limit."""
    rate_burst: int = Field(20, ge=1, alias="CSPACE_API_BURST")
    """Requests that a client may send at once before its rate counts."""
    # Less than 8 MiB would refuse bodies that are not too large.
    held_body_bytes: _BytesOf8MiB = Field(64 * MIB, alias="CSPACE_API_HELD_BODIES_MIB")
    """Largest size of all bodies together that have arrived and are not answered, MiB."""
    hosts: _Hosts = Field((), alias=HOSTS)
    """Names that the server answers to beside loopback and --host; * for any."""
    origins: _Origins = Field((), alias="CSPACE_API_ORIGINS")
    """Origins of other sites whose pages may use the server, as https://host:port."""
    trusted_proxies: _Networks = Field((), alias="CSPACE_API_TRUSTED_PROXIES")
    """Addresses and networks whose X-Forwarded-For and -Proto are believed."""


class ConnectionLimits(_Settings):
    """What one connection may take, and how many there may be."""

    connections: int = Field(512, ge=1, alias="CSPACE_API_MAX_CONNECTIONS")
    """Connections that are open at the same time in one process."""
    header_timeout_s: float = Field(10.0, gt=0.0, alias="CSPACE_API_HEADER_TIMEOUT_S")
    """Time from a request's first byte to the end of its headers, for the first from the connection on, s."""
    write_timeout_s: float = Field(10.0, gt=0.0, alias="CSPACE_API_WRITE_TIMEOUT_S")
    """Time for an answer that the client does not read, s."""


class ApiSettings(_Settings):
    """Everything that can be set; fields without a variable follow from others."""

    registry_uri: str | None = Field(None, alias="MLFLOW_TRACKING_URI")
    """Address of the registry; none serves the shipped models only."""
    cache_folder: Path = Field(alias=CACHE_FOLDER)
    """Folder of downloaded bundles."""
    model_name: Annotated[str, AfterValidator(_served_name)] = Field(DEFAULT_MODEL, alias="CSPACE_MODEL_NAME")
    """The registered model whose champion is the default."""
    poll_s: float = Field(2.0, gt=0.0, alias="CSPACE_MODEL_POLL_S")
    """Time between two looks at the champion's alias, s."""
    pretrained_folder: Path = Field(PRETRAINED_FOLDER, alias=PRETRAINED_MODEL)
    """Folder of the shipped bundle."""
    further_folders: Mapping[str, Path] = Field(default_factory=dict)
    """Shipped bundles of other robots, by name."""
    loaded_bundles: int = Field(4, ge=1, alias="CSPACE_LOADED_MODELS")
    """Bundles beside champion and shipped ones that stay in memory."""
    stored_bundles: int = Field(20, ge=1, alias="CSPACE_STORED_MODELS")
    """Versions of each model that stay on disk beside its champion."""
    trusted_key: Annotated[Path, AfterValidator(_trusted_key)] | None = Field(
        None, alias="CSPACE_TRUSTED_KEY"
    )
    """PEM file of a public key that registered models have to be signed by."""
    cached_pictures: int = Field(256, ge=0, alias="CSPACE_CACHED_PICTURES")
    """Encoded pictures that stay in memory; 0 for none."""
    threads: int = Field(default_factory=usable_cores, ge=1, alias=THREADS)
    """Requests that one process computes at the same time."""
    metrics_folder: Path | None = Field(None, alias=METRICS_FOLDER)
    """Where the processes of one server keep their metrics, which --workers sets."""
    protection: Protection = Field(default_factory=Protection)
    connections: ConnectionLimits = Field(default_factory=ConnectionLimits)
    traces: bool = False
    """Whether spans are sent, by OpenTelemetry's own variables."""
    grace_s: int = Field(10, ge=1, alias="CSPACE_API_GRACE_S")
    """Time for requests in flight when the server is told to end, whole s."""
    load_planner: _Switch = Field(default=True, alias="CSPACE_API_LOAD_PLANNER")
    """Whether the search of plans is loaded before the server is ready; 0 leaves that to the first plan."""
    guide_folder: Path = Field(GUIDE_FOLDER, alias="CSPACE_API_GUIDE")
    """Folder of the built documentation site, for /guide; it need not be there."""
    workbench: _Switch = Field(default=False, alias=WORKBENCH)
    """Whether the page at / may ask for the truth of scenes; 1 is as --workbench."""
    mlflow_pages: Annotated[str, AfterValidator(_pages)] | None = Field(None, alias="CSPACE_API_MLFLOW_PAGES")
    """Where browsers find MLflow's pages, for links."""
    outcomes_folder: Path | None = Field(None, alias=FOLDER)
    """Folder where outcomes wait for their upload; none keeps none."""
    outcomes_bytes: _BytesOf16MiB = Field(256 * MIB, alias="CSPACE_OUTCOMES_MIB")
    """Largest size of the folder of outcomes, MiB."""
    receipt_key: str = Field("", alias="CSPACE_RECEIPT_KEY")
    """Secret of the receipts of answers; if empty, one is made in the folder of outcomes."""
    kept_pictures_days: float = Field(0.0, ge=0.0, le=3650.0, alias="CSPACE_OUTCOMES_KEEP_DAYS")
    """How long pictures and paths of plans whose requests say keep may be kept, days; 0 keeps none."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] | None = None) -> Self:
        """Read ``MLFLOW_TRACKING_URI`` and the ``CSPACE_*`` settings of the API.

        Raises:
            ConfigError: a value is not what the setting takes.
        """
        values = os.environ if environment is None else environment
        cache = Path(values.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cspace-sampler" / "models"
        return cls.read(
            {**values, CACHE_FOLDER: values.get(CACHE_FOLDER) or str(cache)},
            # Whoever serves a folder of their own gets no other shipped model.
            further_folders={} if values.get(PRETRAINED_MODEL) else further_folders(),
            protection=Protection.read(values),
            connections=ConnectionLimits.read(values),
            traces=wants_traces(values),
        )


def described_settings() -> Iterator[str]:
    """A line for each environment variable: its name, and what it sets."""
    for kind in (ApiSettings, Protection, ConnectionLimits):
        for one in kind.model_fields.values():
            if one.alias is not None:
                yield f"{one.alias}: {one.description}"
