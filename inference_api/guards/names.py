"""Lists of names and addresses as settings give them: separated by commas, each checked."""

import ipaddress
import re

from cspace.errors import ConfigError

ANY = "*"
_HOST = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*|\[[0-9A-Fa-f:.]+\]", re.ASCII)
_ORIGIN = re.compile(r"https?://(?:[A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\])(?::[0-9]{1,5})?", re.ASCII)


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


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",") if part.strip()]


def _wrong(name: str, expected: str, got: str) -> ConfigError:
    return ConfigError(
        f"the setting {name} is wrong",
        expected=expected,
        got=repr(got),
        remedy=f"set {name} in the environment, separated by commas, or unset it",
    )
