"""Which pages the guards leave alone."""

from starlette.types import Scope

HEALTH = ("/health/live", "/health/ready", "/v2/health/live", "/v2/health/ready")
METRICS = "/metrics"
WORKBENCH = "/"
WORKBENCH_FILES = "/workbench/files"


def is_health(scope: Scope) -> bool:
    """Whether a request asks for a health page; orchestrators have no key and must not wait."""
    return scope["path"] in HEALTH


def is_watching(scope: Scope) -> bool:
    """Whether a request only watches the server, which matters most when it is overloaded."""
    return is_health(scope) or scope["path"] == METRICS


def is_open(scope: Scope) -> bool:
    """Whether a request needs no key: health, and the workbench's own files, in which one enters the key."""
    return is_health(scope) or scope["path"] == WORKBENCH or scope["path"].startswith(f"{WORKBENCH_FILES}/")
