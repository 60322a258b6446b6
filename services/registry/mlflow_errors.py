"""MLflow's exceptions, and those of what it stands on, become the project's."""

from collections.abc import Iterator
from contextlib import contextmanager

from google.protobuf.json_format import ParseError  # type: ignore[import-untyped]
from mlflow.exceptions import MlflowException
from requests.exceptions import HTTPError, RequestException

from cspace.errors import ModelNotFoundError, RegistryError, RegistryUnavailableError, StorageError
from services.registry.failures import disk_failure
from services.registry.scrubbing import without_user_info

# A name that MLflow calls invalid names nothing, and a missing alias is an "invalid parameter" to it.
_MISSING = frozenset({"RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE", "NOT_FOUND"})
_AWAY = frozenset({"TEMPORARILY_UNAVAILABLE", "REQUEST_LIMIT_EXCEEDED", "DEADLINE_EXCEEDED"})
_MAX_WORDS = 500


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
        raise _of_network(action, error, lookup) from error
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


def _of_network(action: str, error: MlflowException | OSError, lookup: bool) -> RegistryError | StorageError:
    if isinstance(error, MlflowException):
        return _from_mlflow(action, error, lookup)
    if isinstance(error, RequestException):
        return _from_requests(action, error)
    return _not_writable(action, error.strerror or type(error).__name__)


def _not_writable(action: str, got: str) -> StorageError:
    return StorageError(
        f"{action}: a file of this machine cannot be read or written",
        expected="a folder with room and rights",
        got=got,
        remedy="free some space, or choose another folder",
    )


def _from_mlflow(action: str, error: MlflowException, lookup: bool) -> RegistryError | StorageError:
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
