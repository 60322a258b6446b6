"""Jobs on the Ray head, through its jobs API: submit, follow the log, fail loudly."""

import re
import time
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

from cspace.errors import JobError
from services.local.servers.ray_token import token_headers
from services.local.settings import Settings

if TYPE_CHECKING:
    from ray.job_submission import JobSubmissionClient

POLL_S = 1.0
LOOKS = 5
LAST_LINES = 30
SUCCEEDED = "SUCCEEDED"
ENDED = (SUCCEEDED, "FAILED", "STOPPED")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Jobs(Protocol):
    """What is needed of a jobs API."""

    def submit(self, entrypoint: str) -> str:
        """Submit a job; its id."""
        ...

    def state(self, job: str) -> str:
        """PENDING, RUNNING, SUCCEEDED, FAILED or STOPPED."""
        ...

    def log(self, job: str) -> str:
        """All that the job has written so far."""
        ...


class RayJobs:
    """The jobs API of the Ray head of ``make up``, over one client that is made when it is first needed."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._client: JobSubmissionClient | None = None

    def submit(self, entrypoint: str) -> str:
        """Submit a job that runs in the head's own folder.

        It asks for no resources of its own: on a small machine it would wait for those that its trials hold.

        Raises:
            JobError: the head refused it or does not answer.
        """
        return self._ask(lambda client: client.submit_job(entrypoint=entrypoint))

    def state(self, job: str) -> str:
        """See :class:`Jobs`.

        Raises:
            JobError: the head does not answer.
        """
        return self._ask(lambda client: str(client.get_job_status(job).value))

    def log(self, job: str) -> str:
        """See :class:`Jobs`.

        Raises:
            JobError: the head does not answer.
        """
        return self._ask(lambda client: str(client.get_job_logs(job)))

    def _ask(self, question: "Callable[[JobSubmissionClient], str]") -> str:
        try:
            self._client = self._client or _connect(self.settings)
            return question(self._client)
        except (RuntimeError, ConnectionError, OSError) as error:
            raise JobError(
                "Ray's jobs API does not answer as it should",
                got=str(error)[:500],
                remedy=f"see {self.settings.logs_folder / 'ray.log'} and `make status`",
            ) from error


def follow(
    jobs: Jobs, job: str, show: Callable[[str], None], pause: Callable[[float], None] = time.sleep
) -> str:
    """Show a job's lines as they come until it ends; its whole log, without colours.

    Raises:
        JobError: the job failed or was stopped, and the last lines of its log are told; or the head is gone.
    """
    shown = 0
    while True:
        state, log = _look(jobs, job, pause)
        complete = log if state in ENDED else log[: log.rfind("\n") + 1]
        for line in complete[shown:].splitlines():
            show(line)
        shown = max(shown, len(complete))
        if state in ENDED:
            break
        pause(POLL_S)
    if state != SUCCEEDED:
        last = "\n".join(log.splitlines()[-LAST_LINES:])
        raise JobError(
            f"the job {job} ended as {state}; the last lines of its log:\n{last}",
            remedy=f"the rest: `ray job logs {job}` in a shell set up by `python -m services.local env`",
        )
    return log


def _look(jobs: Jobs, job: str, pause: Callable[[float], None]) -> tuple[str, str]:
    """A job's state and what it had written then or a little later."""
    for _ in range(LOOKS - 1):
        # A head whose machine is busy with trials may miss a question; the job goes on all the same.
        with suppress(JobError):
            return jobs.state(job), _COLOUR.sub("", jobs.log(job))
        pause(POLL_S)
    return jobs.state(job), _COLOUR.sub("", jobs.log(job))


def _connect(settings: Settings) -> "JobSubmissionClient":
    # Imported here: Ray takes a second, and the commands that submit nothing need not wait for it.
    from ray.job_submission import JobSubmissionClient  # noqa: PLC0415

    # The token goes with the request, so that this process needs no Ray settings in its environment.
    return JobSubmissionClient(settings.ray_url, headers=token_headers())
