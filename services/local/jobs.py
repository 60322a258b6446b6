"""Jobs on the Ray head: submit, follow the log, read the result and copy the pictures."""

import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import httpx
from pydantic import BaseModel, StrictBool, ValidationError

from cspace.errors import JobError, RegistryError
from cspace.strict_json import refused
from services.local.settings import Settings, token_headers
from services.results import PREFIX


class TrainingResult(BaseModel):
    """The new version of a training job.

    Args:
        run_id: its run in the tracking server.
        model: the registered model.
        version: the new version's number.
        digest: of the bundle.
        figures: names of the pictures in the run.
    """

    run_id: str
    model: str
    version: int
    digest: str
    figures: tuple[str, ...] = ()

    @property
    def reference(self) -> str:
        """``name/version``, as the API and the evaluator take it."""
        return f"{self.model}/{self.version}"


class EvaluationResult(BaseModel):
    """The verdict of an evaluation job.

    Args:
        run_id: its run in the tracking server.
        version: that was evaluated.
        promoted: whether it is the champion now.
        reasons: for the verdict.
        metrics: all numbers by name.
        figures: names of the pictures in the run.
    """

    run_id: str
    version: int
    promoted: StrictBool
    reasons: tuple[str, ...]
    metrics: dict[str, float]
    figures: tuple[str, ...] = ()


Result = TypeVar("Result", TrainingResult, EvaluationResult)


def last_result(log: str, kind: type[Result]) -> Result:
    """The last result in a job's log.

    Raises:
        JobError: there is none, or it lacks something.
    """
    lines = [line for line in log.splitlines() if line.startswith(PREFIX)]
    if not lines:
        raise JobError("the job left no result", expected=f"a last line `{PREFIX}{{...}}`")
    try:
        return kind.model_validate_json(lines[-1].removeprefix(PREFIX))
    except ValidationError as error:
        raise refused(error, JobError, "the job's result") from error


# Where the tracking adapter puts figures within a run.
RUN_FOLDER = "figures"


def fetch_pictures(url: str, run_id: str, names: Sequence[str], folder: Path) -> list[Path]:
    """Copy a run's figures by name; the files.

    Args:
        url: of the tracking server.
        run_id: whose figures.
        names: with or without ``.png``.
        folder: that the files go to; made if it is not there.

    Raises:
        RegistryError: a figure is not there, or the server does not answer.
    """
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for name in names:
        # A name is a run's word, not a path of this machine.
        file = f"{Path(name).name.removesuffix('.png')}.png"
        query = {"run_uuid": run_id, "path": f"{RUN_FOLDER}/{file}"}
        try:
            answer = httpx.get(f"{url}/get-artifact", params=query, timeout=30.0, trust_env=False)
            answer.raise_for_status()
        except httpx.HTTPError as error:
            what = f"the figure {RUN_FOLDER}/{file} of run {run_id} cannot be fetched"
            raise RegistryError(what, got=str(error)) from error
        found.append(folder / file)
        found[-1].write_bytes(answer.content)
    return found


if TYPE_CHECKING:
    from ray.job_submission import JobSubmissionClient

POLL_S = 1.0
LOOKS = 5
LAST_LINES = 30
SUCCEEDED = "SUCCEEDED"
ENDED = (SUCCEEDED, "FAILED", "STOPPED")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


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
        """PENDING, RUNNING, SUCCEEDED, FAILED or STOPPED.

        Raises:
            JobError: the head does not answer.
        """
        return self._ask(lambda client: str(client.get_job_status(job).value))

    def log(self, job: str) -> str:
        """All that the job has written so far.

        Raises:
            JobError: the head does not answer.
        """
        return self._ask(lambda client: str(client.get_job_logs(job)))

    def _ask(self, question: "Callable[[JobSubmissionClient], str]") -> str:
        # Imported here: Ray takes a second, and the commands that submit nothing need not wait for it.
        from ray.job_submission import JobSubmissionClient  # noqa: PLC0415

        try:
            # The token goes with the request, so that this process needs no Ray settings in its environment.
            self._client = self._client or JobSubmissionClient(self.settings.ray_url, headers=token_headers())
            return question(self._client)
        except (RuntimeError, ConnectionError, OSError) as error:
            raise JobError(
                "Ray's jobs API does not answer as it should",
                got=str(error)[:500],
                remedy=f"see {self.settings.logs_folder / 'ray.log'} and `make status`",
            ) from error


def follow(
    jobs: RayJobs, job: str, show: Callable[[str], None], sleep: Callable[[float], None] = time.sleep
) -> str:
    """Show a job's lines as they come until it ends; its whole log, without colours.

    Raises:
        JobError: the job failed or was stopped, and the last lines of its log are told; or the head is gone.
    """
    shown = 0
    while True:
        state, log = _look(jobs, job, sleep)
        complete = log if state in ENDED else log[: log.rfind("\n") + 1]
        for line in complete[shown:].splitlines():
            show(line)
        shown = max(shown, len(complete))
        if state in ENDED:
            break
        sleep(POLL_S)
    if state != SUCCEEDED:
        last = "\n".join(log.splitlines()[-LAST_LINES:])
        raise JobError(
            f"the job {job} ended as {state}; the last lines of its log:\n{last}",
            remedy=f"the rest: `ray job logs {job}` in a shell set up by `python -m services.local env`",
        )
    return log


def _look(jobs: RayJobs, job: str, sleep: Callable[[float], None]) -> tuple[str, str]:
    """A job's state and what it had written then or a little later."""
    for _ in range(LOOKS - 1):
        # A head whose machine is busy with trials may miss a question; the job goes on all the same.
        with suppress(JobError):
            return jobs.state(job), _COLOUR.sub("", jobs.log(job))
        sleep(POLL_S)
    return jobs.state(job), _COLOUR.sub("", jobs.log(job))
