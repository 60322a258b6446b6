"""The tracking server: SQLite and artifacts in the state folder."""

from services.local.environment import binaries, service_environment
from services.local.servers.health import answers
from services.local.servers.service import Service
from services.local.settings import HOST, MLFLOW_PORT, Settings


def mlflow_server(settings: Settings) -> Service:
    """MLflow on loopback. Its guard against DNS rebinding lets local names through by default."""
    folder = settings.home / "mlflow"
    # The job runner is for features that are not used here and costs eight processes.
    environment = service_environment(settings) | {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    del environment["MLFLOW_TRACKING_URI"]
    return Service(
        name="mlflow",
        title="MLflow",
        address=settings.mlflow_url,
        port=settings.mlflow_port,
        setting=MLFLOW_PORT,
        command=lambda: (
            str(binaries() / "mlflow"),
            "server",
            f"--host={HOST}",
            f"--port={settings.mlflow_port}",
            "--workers=1",
            f"--backend-store-uri=sqlite:///{folder / 'mlflow.db'}",
            f"--artifacts-destination={folder / 'artifacts'}",
            "--serve-artifacts",
            # The API asks for the champion every other second, and the log would never end.
            "--uvicorn-opts=--no-access-log",
        ),
        environment=environment,
        folder=folder,
        ready=lambda: answers(f"{settings.mlflow_url}/health"),
        start_limit_s=180.0,
        stop_grace_s=10.0,
    )
