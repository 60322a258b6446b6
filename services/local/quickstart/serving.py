"""Asking the inference API which versions it serves."""

import json
import time
from collections.abc import Callable

import httpx

from cspace.errors import ServiceStartError

POLL_S = 0.5
LIMIT_S = 60.0


def wait_served(
    url: str,
    reference: str,
    *,
    default: bool,
    limit_s: float = LIMIT_S,
    transport: httpx.BaseTransport | None = None,
    pause: Callable[[float], None] = time.sleep,
) -> None:
    """Wait until ``GET /models`` lists a version.

    Args:
        url: of the API.
        reference: ``name/version``.
        default: whether it must also be what requests get that name no model.
        limit_s: when to give up.
        transport: of httpx; None for the network.
        pause: between two looks.

    Raises:
        ServiceStartError: the time is up.
    """
    until = time.monotonic() + limit_s
    with httpx.Client(base_url=url, timeout=5.0, trust_env=False, transport=transport) as client:
        while True:
            seen = _models(client, reference.partition("/")[0])
            if any(ref == reference and (chosen or not default) for ref, chosen in seen.items()):
                return
            if time.monotonic() > until:
                break
            pause(POLL_S)
    raise ServiceStartError(
        f"the inference API does not serve {reference}{' by default' if default else ''}",
        got=f"{sorted(seen)} after {limit_s:.0f} s",
        remedy="see its log, api.log in the logs folder",
    )


def listed_models(url: str, name: str) -> frozenset[str]:
    """What requests may name of a model and of what is shipped; empty while the API does not answer."""
    with httpx.Client(base_url=url, timeout=5.0, trust_env=False) as client:
        return frozenset(_models(client, name))


def _models(client: httpx.Client, name: str) -> dict[str, bool]:
    """References of a model with whether each is the default; empty while the API does not answer."""
    try:
        listed = client.get("/models", params={"name": name}).raise_for_status().json()["models"]
        return {str(one["reference"]): one["default"] is True for one in listed}
    except (httpx.HTTPError, json.JSONDecodeError, KeyError, TypeError):
        return {}
