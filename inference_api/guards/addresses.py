"""Addresses as subscribers: what one party is given counts as one."""

import ipaddress
from functools import lru_cache

# What one subscriber is usually given; single addresses of it are free to choose.
SUBSCRIBER_BITS = 64
# RFC 6052: a translator's clients, each with its IPv4 address in the last 32 bits.
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")


@lru_cache(maxsize=4096)
def subscriber(host: str) -> str:
    """The address, of IPv6 the first half; an IPv4 address inside one of IPv6 counts as itself.

    Args:
        host: an address; what is none is its own subscriber.
    """
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address):
        inner = _inner(address)
        if inner is None:
            return str(ipaddress.ip_network((int(address), SUBSCRIBER_BITS), strict=False))
        address = inner
    return str(address)


def _inner(address: ipaddress.IPv6Address) -> ipaddress.IPv4Address | None:
    """The IPv4 address inside: mapped, translated (NAT64), or tunnelled (6to4, with 65536 halves each)."""
    if address in _NAT64:
        return ipaddress.IPv4Address(int(address) & 0xFFFFFFFF)
    return address.ipv4_mapped or address.sixtofour
