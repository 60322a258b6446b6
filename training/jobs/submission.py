"""Under which id ``ray job submit`` started this process, and what to do with it."""

import json
import os
from collections.abc import Mapping

# How Ray hands a submitted job its metadata.
_VARIABLE = "RAY_JOB_CONFIG_JSON_ENV_VAR"


def submission_id(environment: Mapping[str, str] = os.environ) -> str | None:
    """Ray's id of the submission; None where the process was started in another way."""
    try:
        return str(json.loads(environment[_VARIABLE])["metadata"]["job_submission_id"])
    except (LookupError, TypeError, ValueError):
        return None


def explanation(submission: str | None) -> tuple[str, ...]:
    """What whoever follows the job's log should know of it, in lines; none without a submission."""
    if submission is None:
        return ()
    return (
        f"submission: {submission}. Ctrl-C, or closing the terminal, ends this log and not the job.",
        f"  to stop the job:         ray job stop {submission}",
        f"  to follow its log again: ray job logs --follow {submission}",
    )
