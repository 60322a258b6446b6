"""What failed in a dependency, in words without secrets, addresses and paths."""

import errno
import os
import re
from collections.abc import Iterator

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


# The disk or the rights of this machine, never a network.
_DISK = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EFBIG})
# MLflow gathers the failures of its downloads as text.
_IN_WORDS = re.compile(r"\[Errno (\d{1,3})\]")
_CODE = re.compile(r"[A-Z][A-Z_]{0,40}")
_LONGEST_CHAIN = 20


def failure_of(error: BaseException) -> str:
    """The kinds of failure down to the cause, as ``ConnectionError, Connection refused``."""
    kinds: dict[str, None] = {}
    for one in _chain(error):
        kinds.update(dict.fromkeys(_kinds(one)))
    return ", ".join(kinds)


def disk_failure(error: BaseException) -> str | None:
    """What this machine's disk lacks, if that is anywhere in the chain of causes, in the system's words."""
    for one in _chain(error):
        number = one.errno if isinstance(one, OSError) else None
        if number in _DISK:
            return os.strerror(number)
        if _code(one) is not None:
            for found in _IN_WORDS.findall(str(one)):
                if int(found) in _DISK:
                    return os.strerror(int(found))
    return None


def _kinds(error: BaseException) -> Iterator[str]:
    code, status = _code(error), getattr(getattr(error, "response", None), "status_code", None)
    if isinstance(error, OSError) and error.errno:
        yield os.strerror(error.errno)
    elif code is not None and _CODE.fullmatch(code):
        yield code
    else:
        yield type(error).__name__
    if isinstance(status, int):
        yield f"status {status}"


def _code(error: BaseException) -> str | None:
    """Of MLflow's exceptions, which are known by it, for their module takes seconds to import."""
    code = getattr(error, "error_code", None)
    return None if code is None else str(code)


def _chain(error: BaseException) -> Iterator[BaseException]:
    one: BaseException | None = error
    for _ in range(_LONGEST_CHAIN):
        if one is None:
            return
        yield one
        one = one.__cause__ or one.__context__
