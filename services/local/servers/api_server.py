"""The inference API as a process of its own."""

import sys

from services.local.environment import service_environment
from services.local.servers.health import answers, problem_at
from services.local.servers.service import Service
from services.local.settings import API_PORT, HOST, Settings


def api_server(settings: Settings) -> Service:
    """``python -m inference_api``; it answers before the registry does and looks for champions by itself.

    On a machine of one's own its page tells the truth of scenes, and links to MLflow.
    """
    return Service(
        name="api",
        title="inference API",
        address=settings.api_url,
        port=settings.api_port,
        setting=API_PORT,
        command=lambda: (
            sys.executable,
            "-m",
            "inference_api",
            f"--host={HOST}",
            f"--port={settings.api_port}",
        ),
        environment={
            **service_environment(settings),
            "CSPACE_API_WORKBENCH": "1",
            "CSPACE_API_MLFLOW_PAGES": settings.mlflow_url,
        },
        folder=settings.root,
        # Without any model it is not ready either, and stays so until one is trained.
        ready=lambda: (
            answers(f"{settings.api_url}/health/live")
            and not problem_at(f"{settings.api_url}/health/ready").endswith(":starting")
        ),
        start_limit_s=120.0,
        stop_grace_s=12.0,
    )
