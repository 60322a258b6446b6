"""A jobs API whose one job is at a later point each time it is looked at."""

from collections.abc import Sequence


class FakeJobs:
    """Plays back states with the log at each; the last one stays."""

    def __init__(self, looks: Sequence[tuple[str, str]]) -> None:
        self.looks = list(looks)
        self.submitted: list[str] = []

    def submit(self, entrypoint: str) -> str:
        self.submitted.append(entrypoint)
        return "job-1"

    def state(self, job: str) -> str:
        return self.looks[0][0]

    def log(self, job: str) -> str:
        log = self.looks[0][1]
        if len(self.looks) > 1:
            self.looks.pop(0)
        return log
