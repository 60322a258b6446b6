"""The jobs that run on a Ray head, told before it is ended."""

import json
import time
from collections.abc import Mapping

from services.local.servers.health import answer_of

_UNDER_WAY = {"PENDING", "RUNNING"}


def jobs_under_way(url: str, headers: Mapping[str, str]) -> tuple[str, ...]:
    """Submitted jobs that have not ended, in lines; none where there is none or the head does not answer.

    Args:
        url: of the jobs API.
        headers: with the token.
    """
    try:
        listed = json.loads(answer_of(f"{url}/api/jobs/", headers) or "[]")
        found = [job for job in listed if job["submission_id"] and job["status"] in _UNDER_WAY]
        lines = [
            f"  {job['submission_id']}, since {_moment(job['start_time'])}: {job['entrypoint']}"
            for job in found
        ]
    except (ValueError, LookupError, TypeError):
        return ()
    if not lines:
        return ()
    return ("these jobs end with Ray; a training job goes on when it is submitted again:", *lines)


def _moment(start_ms: float | None) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime((start_ms or 0) / 1000))
