"""Jobs on the Ray head, through its jobs API: submit, follow the log, fail loudly."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cspace.errors import JobError
from services.local.ray_token import token_headers
from services.local.settings import Settings

if TYPE_CHECKING:
    from ray.job_submission import JobSubmissionClient

POLL_S = 1.0
LAST_LINES = 30
SUCCEEDED = "SUCCEEDED"
ENDED = (SUCCEEDED, "FAILED", "STOPPED")


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


@dataclass(frozen=True, slots=True)
class RayJobs:
    """The jobs API of the Ray head of ``make up``."""

    settings: Settings

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
            return question(_client(self.settings))
        except (RuntimeError, ConnectionError, OSError) as error:
            raise JobError(
                "Ray's jobs API does not answer as it should",
                got=str(error)[:500],
                remedy=f"see {self.settings.logs_folder / 'ray.log'} and `make status`",
            ) from error


def follow(
    jobs: Jobs, job: str, show: Callable[[str], None], pause: Callable[[float], None] = time.sleep
) -> str:
    """Show a job's lines as they come until it ends; its whole log.

    Raises:
        JobError: the job failed or was stopped; the message ends with the last lines of its log.
    """
    shown = 0
    while True:
        state = jobs.state(job)
        log = jobs.log(job)
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


def _client(settings: Settings) -> "JobSubmissionClient":
    # Imported here: Ray takes a second, and the commands that submit nothing need not wait for it.
    from ray.job_submission import JobSubmissionClient  # noqa: PLC0415

    # The token goes with the request, so that this process needs no Ray settings in its environment.
    return JobSubmissionClient(settings.ray_url, headers=token_headers())
