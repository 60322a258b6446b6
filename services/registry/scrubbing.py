"""Texts of others without secrets, and, where clients read them, without addresses and paths."""

import re

MAX_LENGTH = 500
# A password may hold nearly anything, so all up to the last @ goes.
_USER_INFO = re.compile(r"(?<=://)[^\s'\"<>]*@")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_ADDRESSES = re.compile(
    r"""
    [A-Za-z][A-Za-z0-9+.-]*://[^\s'"<>]*                # anything with a scheme
    | (?:host|Host)=(?:'[^']*'|"[^"]*")(?:,\ ?port=\d+)?  # as urllib3 writes it
    | \[[0-9A-Fa-f:.]{2,}\](?::\d+)?                    # IPv6
    | (?<![\w.])\d{1,3}(?:\.\d{1,3}){3}(?::\d+)?(?![\w.])  # IPv4
    | (?<![\w.-])(?:[\w-]+\.)*[A-Za-z][\w-]*:\d{2,5}\b  # name:port
    """,
    re.VERBOSE,
)
_PATHS = re.compile(r"(?<![\w.])~?/[^\s'\":;,()<>]+")


def without_user_info(text: str) -> str:
    """A text whose addresses have no user and no password."""
    return _USER_INFO.sub("", text)


def anonymous(text: str) -> str:
    """One line of a text, without addresses, hosts, absolute paths and control characters; 500 characters."""
    line = " ".join(_CONTROL.sub(" ", without_user_info(text)).split())
    line = _PATHS.sub("(a path)", _ADDRESSES.sub("(an address)", line))
    return line if len(line) <= MAX_LENGTH else line[:MAX_LENGTH] + " ..."
