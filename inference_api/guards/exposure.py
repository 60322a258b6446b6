"""Who can reach an address, and whether that may be without keys."""

import ipaddress

from cspace.errors import ConfigError
from inference_api.guards.protection import Protection
from inference_api.keys import ApiKeys


def check_exposure(host: str, protection: Protection, *, allowed: bool) -> None:
    """Refuse to listen where other machines may ask without a key.

    Args:
        host: address to listen on.
        protection: with the file of keys, which is read here to tell of a wrong one before the start.
        allowed: whether whoever starts the server wants just that.

    Raises:
        ConfigError: no keys and another address than loopback, or a wrong file of keys.
    """
    if protection.keys_file is not None:
        ApiKeys.read(protection.keys_file)
    elif not allowed and not is_loopback(host):
        raise ConfigError(
            "everybody who reaches the server could use it",
            expected="a loopback address, or keys",
            got=f"--host {host!r} without CSPACE_API_KEYS_FILE",
            remedy="make keys with python -m inference_api.keys NAME, or say --allow-unauthenticated",
        )


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address; a name other than localhost counts as reachable."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_wildcard(host: str) -> bool:
    """Whether a server there listens on all addresses, so that it has no name of its own."""
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return host == ""
