"""Settings of the inference API: environment variables, read once at the start."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field, FilePath, IPvAnyNetwork
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from services.registry.entities import PRETRAINED, SHIPPED, is_model_name

PRETRAINED_FOLDER = Path(__file__).parent / "pretrained"
# Where `make docs` of a checkout builds it.
GUIDE_FOLDER = Path(__file__).parents[1] / "build" / "docs"
# As they stand in headers, hosts without a port.
_HOST = r"^(\*|[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*|\[[0-9A-Fa-f:.]+\])$"
_ORIGIN = r"^https?://([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?$"


def bracketed(host: str) -> str:
    """A host as it stands in a Host header: an address of IPv6 in brackets."""
    return f"[{host}]" if host.count(":") > 1 and not host.startswith("[") else host


def further_folders() -> dict[str, Path]:
    """Shipped bundles beside the default robot's, by name; those whose folders are there."""
    beside = {name: PRETRAINED_FOLDER.with_name(folder) for name, folder in SHIPPED.items()}
    return {name: folder for name, folder in beside.items() if name != PRETRAINED and folder.is_dir()}


def _parts(value: object) -> object:
    """The entries of a text, which commas separate."""
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


def _served_name(text: str) -> str:
    if not is_model_name(text) or text in SHIPPED:
        raise ValueError("the name of a registered model, other than a shipped one's")
    return text


_Host = Annotated[str, AfterValidator(bracketed), Field(pattern=_HOST)]
_Origin = Annotated[str, Field(pattern=_ORIGIN)]


class ApiSettings(BaseSettings):
    """Everything that can be set; an empty variable counts as unset."""

    model_config = SettingsConfigDict(
        env_prefix="CSPACE_", env_ignore_empty=True, populate_by_name=True, frozen=True, allow_inf_nan=False
    )

    registry_uri: str | None = Field(None, alias="MLFLOW_TRACKING_URI")
    """Address of the registry; none serves the shipped models only."""
    model_cache: Path = Field(
        default_factory=lambda: (
            Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cspace-sampler" / "models"
        ),
    )
    """Folder of downloaded bundles."""
    model_name: Annotated[str, AfterValidator(_served_name)] = "cspace-sampler"
    """The registered model whose champion is the default."""
    model_poll_s: float = Field(2.0, gt=0.0)
    """Time between two looks at the champion's alias, s."""
    pretrained_model: Path = PRETRAINED_FOLDER
    """Folder of the shipped bundle; another one than the default leaves out those of other robots."""
    loaded_models: int = Field(4, ge=1)
    """Bundles beside champion and shipped ones that stay in memory."""
    stored_models: int = Field(20, ge=1)
    """Versions of each model that stay on disk beside its champion."""
    trusted_key: FilePath | None = None
    """PEM file of a public key that registered models have to be signed by."""
    api_threads: int = Field(default_factory=lambda: len(os.sched_getaffinity(0)), ge=1)
    """Requests that are computed at the same time."""
    api_keys_file: Path | None = None
    """File of API keys; without it everybody may ask."""
    api_max_in_flight: int = Field(64, ge=1)
    """Requests that are answered at the same time; further ones are refused."""
    api_hosts: Annotated[tuple[_Host, ...], NoDecode, BeforeValidator(_parts)] = ()
    """Names that the server answers to beside loopback and --host; * for any."""
    api_origins: Annotated[tuple[_Origin, ...], NoDecode, BeforeValidator(_parts)] = ()
    """Origins of other sites whose pages may use the server, as https://host:port."""
    api_trusted_proxies: Annotated[tuple[IPvAnyNetwork, ...], NoDecode, BeforeValidator(_parts)] = ()
    """Addresses and networks whose X-Forwarded-For and -Proto are believed."""
    api_grace_s: int = Field(10, ge=1)
    """Time for requests in flight when the server is told to end, whole s."""
    api_load_planner: bool = True
    """Whether the search of plans is loaded before the server is ready; 0 leaves that to the first plan."""
    api_guide: Path = GUIDE_FOLDER
    """Folder of the built documentation site, for /guide; it need not be there."""
    api_workbench: bool = False
    """Whether the page at / may ask for the truth of scenes; 1 is as --workbench."""
    outcomes: Path | None = None
    """Folder where outcomes wait for their upload; none keeps none."""
    receipt_key: str = ""
    """Secret of the receipts of plans, for servers that share no folder; else it lies in the folder."""
    outcomes_mib: float = Field(256.0, ge=16.0)
    """Largest size of the folder of outcomes, MiB."""
    outcomes_keep_days: float = Field(0.0, ge=0.0, le=3650.0)
    """How long pictures and paths of plans whose requests say keep may be kept, days; 0 keeps none."""

    @property
    def shipped_folders(self) -> Mapping[str, Path]:
        """Shipped bundles by name, the default robot's first."""
        others = further_folders() if self.pretrained_model == PRETRAINED_FOLDER else {}
        return {PRETRAINED: self.pretrained_model, **others}
