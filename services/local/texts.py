"""What the commands tell people."""

import time
from collections.abc import Sequence

from services.local.environment import shell_lines
from services.local.servers.stack import ServiceStatus
from services.local.settings import Settings
from services.local.state import size_bytes, size_text


def addresses(settings: Settings) -> str:
    """Where to look."""
    return "\n".join(
        [
            f"MLflow UI       {settings.mlflow_url}",
            f"Ray dashboard   {settings.ray_url}  (asks for the token: `ray get-auth-token` prints it)",
            f"API             {settings.api_url}/docs",
            f"workbench       {settings.api_url}/",
        ]
    )


def shell_help(settings: Settings) -> str:
    """How to set a shell up for jobs of one's own."""
    return "\n".join(
        [
            "A shell for `ray job submit training/cluster_train.py` needs these lines",
            '(`eval "$(.venv/bin/python -m services.local env)"` runs them):',
            *(f"  {line}" for line in shell_lines(settings)),
        ]
    )


def status_table(settings: Settings, statuses: Sequence[ServiceStatus]) -> str:
    """One line a service, then the state folder."""
    rows = [("service", "state", "pid", "since", "address")]
    for one in statuses:
        state = ("healthy" if one.healthy else "does not answer") if one.running else "not running"
        since = "-" if one.since is None else time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(one.since))
        rows.append((one.title, state, str(one.pid or "-"), since, one.address))
    folder = f"state folder {settings.home}, {size_text(size_bytes(settings.home))}"
    return f"{aligned(rows)}\n{folder}"


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Columns of texts, left-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join(line.rstrip() for line in lines)
