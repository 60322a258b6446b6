"""Whether the server answers, asked before anything else is, so that its absence is known within seconds.

MLflow's client waits 120 s and tries seven times. Its only settings for that are the environment's, which
hold for the whole process, training included, where the long patience is right. So a lookup asks first, once,
with a short patience of its own. The question goes through to the database: ``/health`` is well while that is
away. A process that only serves may lower the client's patience as well, with :func:`lower_patience`.
"""

from collections.abc import MutableMapping

from mlflow.utils.credentials import get_default_host_creds
from mlflow.utils.rest_utils import http_request

from services.registry.mlflow_errors import mapped, unavailable
from services.registry.scrubbing import without_user_info

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
