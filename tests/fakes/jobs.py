"""A jobs API whose one job is at a later point each time it is looked at."""

from collections.abc import Sequence

from cspace.errors import JobError


class FakeJobs:
    """Plays back states with the log at each; the last one stays. The first questions may be missed."""

    def __init__(self, looks: Sequence[tuple[str, str]], misses: int = 0) -> None:
        self.looks = list(looks)
        self.misses = misses
        self.submitted: list[str] = []

    def submit(self, entrypoint: str) -> str:
        self.submitted.append(entrypoint)
        return "job-1"

    def state(self, job: str) -> str:
        if self.misses:
            self.misses -= 1
            raise JobError("the fake misses a question")
        return self.looks[0][0]

    def log(self, job: str) -> str:
        log = self.looks[0][1]
        if len(self.looks) > 1:
            self.looks.pop(0)
        return log
