"""MLflow's exceptions as the project's, and how long its server is waited for.

MLflow's client waits 120 s and tries seven times. Its only settings for that are the environment's, which
hold for the whole process, training included, where the long patience is right. So a lookup asks first, once,
with a short patience of its own, :func:`check_reachable`. The question goes through to the database:
``/health`` is well while that is away. A process that only serves may lower the client's patience,
:func:`lower_patience`. A job's driver waits longer than MLflow does, :func:`patiently`.
"""

import logging
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager
from typing import Any, TypeVar

from google.protobuf.json_format import ParseError  # type: ignore[import-untyped]
from mlflow.exceptions import MlflowException
from mlflow.store.entities import PagedList
from mlflow.utils.credentials import get_default_host_creds
from mlflow.utils.rest_utils import http_request
from requests.exceptions import HTTPError, RequestException

from cspace.errors import ModelNotFoundError, RegistryError, RegistryUnavailableError, StorageError
from services.registry.failures import disk_failure, without_user_info

# A name that MLflow calls invalid names nothing, and a missing alias is an "invalid parameter" to it.
_MISSING = frozenset({"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE", "NOT_FOUND"})
_AWAY = frozenset({"TEMPORARILY_UNAVAILABLE", "REQUEST_LIMIT_EXCEEDED", "DEADLINE_EXCEEDED"})
_MAX_WORDS = 500
# Between two questions of a patient caller, and two lines of its log that say the same.
LOOK_EVERY_S, LINE_EVERY_S = 5.0, 60.0
_LOG = logging.getLogger("training")
Answer = TypeVar("Answer")
Item = TypeVar("Item")


@contextmanager
def mapped(action: str, *, lookup: bool = False) -> Iterator[None]:
    """Raise the project's errors instead of the dependency's.

    Args:
        action: what is being done, for the message: ``looking up a/1``.
        lookup: whether "there is none" is an answer, and so a ModelNotFoundError.

    Raises:
        RegistryUnavailableError: no connection, no answer in time, or a server that can not answer now.
        ModelNotFoundError: there is none, in a lookup.
        StorageError: a file of this machine can not be read or written, however deep that is wrapped.
        RegistryError: anything else.
    """
    try:
        yield
    except (MlflowException, OSError) as error:
        # First of all, for the exceptions of requests are OSErrors, and MLflow wraps both kinds alike.
        disk = disk_failure(error)
        if disk is not None:
            raise _not_writable(action, disk) from error
        if isinstance(error, MlflowException):
            raise _from_mlflow(action, error, lookup) from error
        if isinstance(error, RequestException):
            raise _from_requests(action, error) from error
        raise _not_writable(action, error.strerror or type(error).__name__) from error
    except (ValueError, KeyError, TypeError, ParseError) as error:
        # JSON or protobuf that does not parse: whatever answers there, it is no MLflow server.
        raise RegistryError(
            f"{action}: the answer is not MLflow's",
            expected="an MLflow tracking server",
            got=_words(error),
            remedy="check MLFLOW_TRACKING_URI",
        ) from error
    except ImportError as error:
        raise RegistryError(
            f"{action}: this address needs more than mlflow-skinny",
            expected="an http address",
            got=_words(error),
            remedy="install mlflow, or start a server on the database and give its address",
        ) from error


def unavailable(action: str, got: str) -> RegistryUnavailableError:
    """The server does not answer."""
    return RegistryUnavailableError(
        f"{action}: the tracking server does not answer",
        expected="an MLflow server at MLFLOW_TRACKING_URI",
        got=got,
        remedy="start it, or wait until its database is back",
    )


def _not_writable(action: str, got: str) -> StorageError:
    return StorageError(
        f"{action}: a file of this machine cannot be read or written",
        expected="a folder with room and rights",
        got=got,
        remedy="free some space, or choose another folder",
    )


def _from_mlflow(action: str, error: MlflowException, lookup: bool) -> RegistryError:
    # Transport errors come wrapped, as the cause or the context of an MlflowException of no special code.
    inner = error.__cause__ or error.__context__
    lost = isinstance(inner, RequestException) and not isinstance(inner, HTTPError)
    if lost or error.error_code in _AWAY:
        return unavailable(action, _words(error))
    if lookup and error.error_code in _MISSING:
        return ModelNotFoundError(
            f"{action}: there is none",
            got=_words(error),
            remedy="register one, or look at the registry's list",
        )
    return RegistryError(f"{action}: MLflow refuses", got=f"{error.error_code}: {_words(error)}")


def _from_requests(action: str, error: RequestException) -> RegistryError:
    status = None if error.response is None else error.response.status_code
    if status is None or status >= 500:
        return unavailable(action, _words(error))
    return RegistryError(f"{action}: the artifact store refuses", got=_words(error))


def _words(error: BaseException) -> str:
    """Others' words, which may hold the address with its password."""
    words = without_user_info(" ".join(str(error).split())) or type(error).__name__
    return words if len(words) <= _MAX_WORDS else words[:_MAX_WORDS] + " ..."


_PROBE = "/api/2.0/mlflow/registered-models/search"
_SERVING = {
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "5",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
}


def check_reachable(uri: str, patience_s: float) -> None:
    """Ask the server for one line of its database.

    Args:
        uri: of the tracking server; one that is not http is a file of this machine, and always there.
        patience_s: for the connection, and again for the answer.

    Raises:
        RegistryUnavailableError: it does not answer in time, or says that it can not.
    """
    if not uri.startswith(("http://", "https://")):
        return
    action = f"asking {without_user_info(uri)}"
    with mapped(action):
        answer = http_request(  # type: ignore[no-untyped-call]
            get_default_host_creds(uri),  # type: ignore[no-untyped-call]
            _PROBE,
            "GET",
            max_retries=0,
            timeout=patience_s,
            raise_on_status=False,
            params={"max_results": 1},
        )
    if answer.status_code >= 500:
        raise unavailable(action, f"status {answer.status_code}")


def lower_patience(environment: MutableMapping[str, str]) -> None:
    """Lower the client's patience for a whole process, and its noise; what is set already stays.

    For the entry point of a process that serves, with ``os.environ``.
    """
    for name, value in _SERVING.items():
        environment.setdefault(name, value)


def all_pages(search: Callable[..., PagedList[Item]], *arguments: Any, **options: Any) -> list[Item]:
    """Everything that one of the client's searches finds."""
    found: list[Item] = []
    token: str | None = None
    while True:
        page = search(*arguments, page_token=token, **options)
        found += page
        token = page.token or None
        if token is None:
            return found


def patiently(action: str, call: Callable[[], Answer], patience_s: float) -> Answer:
    """The answer of ``call``, asked again while the tracking server is away.

    Args:
        action: what is being done, for the log.
        call: may be called again after it has failed.
        patience_s: how long the server may be away.

    Raises:
        RegistryUnavailableError: it stayed away; what is done so far is kept, and the job can be resumed.
    """
    began, said = time.monotonic(), float("-inf")
    while True:
        try:
            return call()
        except RegistryUnavailableError as error:
            waited = time.monotonic() - began
            if waited >= patience_s:
                raise RegistryUnavailableError(
                    f"{action}: the tracking server stayed away for {waited:.0f} s",
                    expected=error.expected,
                    got=error.got,
                    remedy="nothing is lost: start it, then submit the job again by name or resume its run",
                ) from error
            if time.monotonic() - said >= LINE_EVERY_S:
                said = time.monotonic()
                _LOG.info(
                    "%s: the tracking server is away, waiting up to %.0f s", action, patience_s - waited
                )
            time.sleep(LOOK_EVERY_S)
