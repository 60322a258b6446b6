"""MLflow's exceptions as the project's, how long its server is waited for, and texts without secrets.

MLflow's client waits 120 s and tries seven times. Its only settings for that are environment variables of the
whole process, so a lookup first asks the server once with a timeout of its own, :func:`check_reachable`.
MLflow is imported inside the functions: servers scrub texts without it.
"""

import errno
import json
import logging
import os
import re
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from typing import TypeVar

from cspace.errors import ModelNotFoundError, RegistryError, RegistryUnavailableError, StorageError

Answer = TypeVar("Answer")
MAX_LENGTH = 500
# Between two attempts.
LOOK_EVERY_S = 5.0
_LOG = logging.getLogger("training")

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
# The disk or the rights of this machine, never a network; MLflow gathers the failures of downloads as text.
_DISK = re.compile(
    rf"\[Errno ({errno.ENOSPC}|{errno.EDQUOT}|{errno.EROFS}|{errno.EACCES}|{errno.EFBIG})\]", re.ASCII
)
# A name that MLflow calls invalid names nothing, and a missing alias is an "invalid parameter" to it.
_MISSING = frozenset({"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE", "NOT_FOUND"})
_AWAY = frozenset({"TEMPORARILY_UNAVAILABLE", "REQUEST_LIMIT_EXCEEDED", "DEADLINE_EXCEEDED"})


def without_user_info(text: str) -> str:
    """A text whose addresses have no user and no password."""
    return _USER_INFO.sub("", text)


def anonymous(text: str) -> str:
    """One line of a text, without addresses, hosts, absolute paths and control characters; 500 characters."""
    line = _line(_CONTROL.sub(" ", text))
    return _truncate(_PATHS.sub("(a path)", _ADDRESSES.sub("(an address)", line)))


@contextmanager
def mapped(action: str, *, lookup: bool = False) -> Iterator[None]:
    """Raise the project's errors in place of MLflow's and of its transport."""
    from google.protobuf.json_format import ParseError  # type: ignore[import-untyped]  # noqa: PLC0415
    from mlflow.exceptions import MlflowException  # noqa: PLC0415
    from requests.exceptions import RequestException  # noqa: PLC0415

    # An address that is no MLflow server's answers what is no JSON, or other JSON.
    strange = (json.JSONDecodeError, ParseError, KeyError, ImportError)
    try:
        yield
    except (MlflowException, OSError, *strange) as error:
        words, chain = _truncate(_line(str(error)) or type(error).__name__), list(_causes(error))
        code = getattr(error, "error_code", None)
        # The exceptions of requests are OSErrors, and MLflow wraps them and those of the disk alike.
        sent = next((one for one in chain if isinstance(one, RequestException)), None)
        disk = _DISK.search(" ".join(map(str, chain)))
        if disk is not None or (isinstance(error, OSError) and sent is None):
            raise StorageError(
                f"{action}: a file of this machine cannot be read or written",
                expected="a folder with room and rights",
                got=words if disk is None else os.strerror(int(disk[1])),
                remedy="free some space, or choose another folder",
            ) from error
        response = getattr(sent, "response", None)
        if code in _AWAY or (sent is not None and (response is None or response.status_code >= 500)):
            raise RegistryUnavailableError(
                f"{action}: the tracking server does not answer",
                expected="an MLflow server at MLFLOW_TRACKING_URI",
                got=words,
                remedy="start it, or wait until its database is back",
            ) from error
        if lookup and code in _MISSING:
            raise ModelNotFoundError(
                f"{action}: there is none", got=words, remedy="register one, or look at the registry's list"
            ) from error
        raise RegistryError(
            f"{action}: MLflow refuses, or does not answer at this address",
            got=words if code is None else f"{code}: {words}",
            remedy="check MLFLOW_TRACKING_URI",
        ) from error


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _line(text: str) -> str:
    return " ".join(without_user_info(text).split())


def _truncate(text: str) -> str:
    return text if len(text) <= MAX_LENGTH else text[:MAX_LENGTH] + " ..."


def check_reachable(uri: str, timeout_s: float) -> None:
    """Ask the server for one line of its database, for ``/health`` is well while that is away.

    An address that is not http is a file of this machine, and always there.
    """
    from mlflow.utils.credentials import get_default_host_creds  # noqa: PLC0415
    from mlflow.utils.rest_utils import http_request  # noqa: PLC0415

    if not uri.startswith(("http://", "https://")):
        return
    with mapped(f"asking {without_user_info(uri)}"):
        http_request(  # type: ignore[no-untyped-call]
            get_default_host_creds(uri),  # type: ignore[no-untyped-call]
            "/api/2.0/mlflow/registered-models/search",
            "GET",
            max_retries=0,
            timeout=timeout_s,
            params={"max_results": 1},
        )


def set_timeouts(environment: MutableMapping[str, str]) -> None:
    """Lower the client's timeouts for a process that serves; what is set already stays."""
    environment.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "5")
    environment.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "1")
    environment.setdefault("MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR", "1")
    environment.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")


def retry(action: str, call: Callable[[], Answer], wait_s: float) -> Answer:
    """The answer of ``call``, asked again while the tracking server is away, for at most ``wait_s``."""
    began, is_said = time.monotonic(), False
    while True:
        try:
            return call()
        except RegistryUnavailableError as error:
            waited = time.monotonic() - began
            if waited >= wait_s:
                what = f"{action}: the tracking server stayed away for {waited:.0f} s"
                remedy = "nothing is lost: start it, then submit the job again by name or resume its run"
                raise RegistryUnavailableError(what, got=error.got, remedy=remedy) from error
        if not is_said:
            _LOG.info("%s: the tracking server is away, waiting up to %.0f s", action, wait_s)
        is_said = True
        time.sleep(LOOK_EVERY_S)
