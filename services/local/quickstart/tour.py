"""The main job, in order: services, training, evaluation, serving, quality over HTTP, planning, summary."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from services.local.environment import service_environment
from services.local.quickstart.jobs import Jobs, RayJobs, follow
from services.local.quickstart.pictures import fetch_pictures
from services.local.quickstart.planning import plan_and_draw
from services.local.quickstart.quality import served_quality
from services.local.quickstart.results import (
    EvaluationResult,
    TrainingResult,
    evaluation_result,
    training_result,
)
from services.local.quickstart.serving import listed_models, wait_served
from services.local.quickstart.summary import summary
from services.local.quickstart.tours import Tour
from services.local.servers.stack import services, up
from services.local.settings import Settings
from services.local.texts import addresses, shell_help
from services.names import MODEL_NAME
from services.results import PREFIX


@dataclass(frozen=True, slots=True)
class Progress:
    """Lines for people with the time since the beginning.

    Args:
        say: takes a line.
        began: monotonic time in s.
    """

    say: Callable[[str], None]
    began: float = field(default_factory=time.monotonic)

    @property
    def elapsed_s(self) -> float:
        """Since the beginning."""
        return time.monotonic() - self.began

    def stage(self, text: str) -> None:
        """A new stage begins."""
        self.say(f"\n[{self.elapsed_s:5.1f} s] {text}")

    def line(self, text: str) -> None:
        """Something within a stage."""
        self.say(f"[{self.elapsed_s:5.1f} s]   {text}")


def quickstart(settings: Settings, tour: Tour, say: Callable[[str], None]) -> None:
    """Run the main job and print its summary.

    Args:
        settings: of the services.
        tour: what is done.
        say: takes lines for people.

    Raises:
        JobError: a job failed.
        CspaceError: another stage failed.
    """
    progress = Progress(say)
    progress.stage("starting the services")
    up(settings, services(settings), progress.line)
    jobs = RayJobs(settings)
    training = training_result(_run(jobs, tour.train, progress))
    evaluation = evaluation_result(_run(jobs, tour.evaluate.replace("{model}", training.reference), progress))
    progress.stage(f"waiting until the inference API serves {training.reference}")
    # The API's default is one robot's; a model of another one is asked for by its name.
    default = evaluation.promoted and training.model == MODEL_NAME
    wait_served(settings.api_url, training.reference, default=default)
    told = listed_models(settings.api_url, training.model)
    both = tuple(name for name in (training.reference, tour.shipped) if name in told)
    progress.stage(f"quality of {' and '.join(both)} over HTTP, on scenarios that nobody was trained on")
    quality = served_quality(settings.api_url, both, tour)
    progress.stage("planning with samples from POST /sample")
    pictures = _pictures(settings, tour, training, evaluation, progress)
    progress.stage("done")
    say(f"\n{summary(training, evaluation, quality, tour.scenarios, pictures, progress.elapsed_s)}")
    say(f"\n{addresses(settings)}\n\n{shell_help(settings)}\n\nThe services stay up; `make down` ends them.")
    say(f"\nLook at what was trained: {settings.api_url}/")


def _run(jobs: Jobs, entrypoint: str, progress: Progress) -> str:
    progress.stage(f"job: {entrypoint}")
    job = jobs.submit(entrypoint)
    progress.line(f"submitted as {job}; its first line comes when Ray's workers are up")

    def show(line: str) -> None:
        # The result is for this program; the summary tells it.
        if line.strip() and not line.startswith(PREFIX):
            progress.line(line)

    return follow(jobs, job, show)


def _pictures(
    settings: Settings,
    tour: Tour,
    training: TrainingResult,
    evaluation: EvaluationResult,
    progress: Progress,
) -> list[Path]:
    folder = settings.figures_folder / f"{training.model}-{training.version}"
    environment = service_environment(settings)
    model = None if training.model == MODEL_NAME else training.reference
    pictures = plan_and_draw(settings.api_url, settings.root, folder, environment, progress.line, tour, model)
    for run_id, names in ((training.run_id, training.figures), (evaluation.run_id, evaluation.figures)):
        pictures += fetch_pictures(settings.mlflow_url, run_id, names, folder)
    return pictures
