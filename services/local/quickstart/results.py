"""What jobs say at the end of their log: ``RESULT`` and JSON on one line."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from cspace.errors import JobError
from services.results import PREFIX


@dataclass(frozen=True, slots=True)
class TrainingResult:
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
    figures: tuple[str, ...]

    @property
    def reference(self) -> str:
        """``name/version``, as the API and the evaluator take it."""
        return f"{self.model}/{self.version}"


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """The verdict of an evaluation job.

    Args:
        run_id: its run in the tracking server.
        version: that was judged.
        promoted: whether it is the champion now.
        reasons: for the verdict.
        metrics: all numbers by name.
        figures: names of the pictures in the run.
    """

    run_id: str
    version: int
    promoted: bool
    reasons: tuple[str, ...]
    metrics: Mapping[str, float]
    figures: tuple[str, ...]


def training_result(log: str) -> TrainingResult:
    """Read the last result of a training job's log.

    Raises:
        JobError: there is none, or it lacks something.
    """
    with _last_result(log) as fields:
        return TrainingResult(
            run_id=str(fields["run_id"]),
            model=str(fields["model"]),
            version=int(fields["version"]),
            digest=str(fields["digest"]),
            figures=tuple(map(str, fields.get("figures", ()))),
        )


def evaluation_result(log: str) -> EvaluationResult:
    """Read the last result of an evaluation job's log.

    Raises:
        JobError: there is none, or it lacks something.
    """
    with _last_result(log) as fields:
        return EvaluationResult(
            run_id=str(fields["run_id"]),
            version=int(fields["version"]),
            promoted=fields["promoted"] is True,
            reasons=tuple(map(str, fields["reasons"])),
            metrics={str(name): float(value) for name, value in fields["metrics"].items()},
            figures=tuple(map(str, fields.get("figures", ()))),
        )


@contextmanager
def _last_result(log: str) -> Iterator[dict[str, Any]]:
    """The fields of the last result; what cannot be read of them in the block is a JobError."""
    lines = [line for line in log.splitlines() if line.startswith(PREFIX)]
    if not lines:
        raise JobError("the job left no result", expected=f"a last line `{PREFIX}{{...}}`")
    try:
        fields = json.loads(lines[-1].removeprefix(PREFIX))
    except ValueError as error:
        raise JobError("the job's result is not JSON", got=lines[-1][:200]) from error
    if not isinstance(fields, dict):
        raise JobError("the job's result is not an object", got=lines[-1][:200])
    try:
        yield fields
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise JobError("the job's result lacks something", got=f"{error!r} in {sorted(fields)}") from error
