"""The guided run: services, training, evaluation, serving, quality over HTTP, planning, summary."""

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np

from cspace.errors import PlanningError, ServiceStartError
from cspace.query import SampleQuery
from cspace.simulator import Split
from cspace.world import World
from cspace.worlds import named_world, picture_file_of, robot_digest
from services.evaluator.measures.sample_quality import (
    ReconstructionSummary,
    SamplerSummary,
    SceneQuality,
    summarise,
)
from services.evaluator.measures.scenes import Scene, Stage
from services.evaluator.statistics import Interval
from services.evaluator.tables import aligned
from services.local.jobs import (
    EvaluationResult,
    RayJobs,
    TrainingResult,
    fetch_pictures,
    follow,
    last_result,
)
from services.local.settings import Settings, service_environment
from services.local.stack import addresses, services, shell_help, up
from services.names import MODEL_NAME
from services.planner.client import SamplingClient
from services.planner.samples import SampleSource
from services.registry.entities import PRETRAINED, is_shipped
from services.results import PREFIX

EVALUATE = "python -m services.evaluator --model {model} --without-shipped"


@dataclass(frozen=True, slots=True)
class Tour:
    """The main job of one robot.

    Args:
        robot: name of an example, or the path of a robot's file.
        shipped: the model that comes with the server; None where none is of this robot.
        train: entry point of the training job.
        evaluate: of the evaluation job, with ``{model}`` where the version goes.
        scenarios: on which served samples are evaluated.
        families: of the problems that are planned and drawn.
    """

    robot: str
    shipped: str | None
    train: str
    evaluate: str
    scenarios: int
    families: tuple[str, ...]

    @property
    def world(self) -> World:
        """The robot's."""
        return named_world(self.robot)


TOURS = {
    "planar": Tour(
        robot="two-link",
        shipped=PRETRAINED,
        train="python training/cluster_train.py --preset quickstart",
        evaluate=EVALUATE,
        scenarios=100,
        families=("uniform", "narrow"),
    ),
    "panda": Tour(
        robot="panda",
        shipped=f"{PRETRAINED}-panda",
        train="python training/cluster_train.py --preset panda_quick",
        evaluate=f"{EVALUATE} --scenarios 20",
        scenarios=20,
        families=("uniform", "shelf"),
    ),
}
USUAL = "planar"


POLL_S = 0.5
LIMIT_S = 60.0


def wait_served(url: str, reference: str, *, default: bool, limit_s: float = LIMIT_S) -> None:
    """Wait until ``GET /models`` lists a version.

    Args:
        url: of the API.
        reference: ``name/version``.
        default: whether it must also be what requests get that name no model.
        limit_s: when to give up.

    Raises:
        ServiceStartError: the time is up.
    """
    until = time.monotonic() + limit_s
    while True:
        seen = listed_models(url, reference.partition("/")[0])
        if reference in seen and (seen[reference] or not default):
            return
        if time.monotonic() > until:
            raise ServiceStartError(
                f"the inference API does not serve {reference}{' by default' if default else ''}",
                got=f"{sorted(seen)} after {limit_s:.0f} s",
                remedy="see its log, api.log in the logs folder",
            )
        time.sleep(POLL_S)


def listed_models(url: str, name: str) -> dict[str, bool]:
    """What requests may name of a model and of what is shipped, with whether each is the default.

    It is empty while the API does not answer.
    """
    try:
        answer = httpx.get(f"{url}/models", params={"name": name}, timeout=5.0, trust_env=False)
        listed = answer.raise_for_status().json()["models"]
        return {str(one["reference"]): one["default"] is True for one in listed}
    except (httpx.HTTPError, json.JSONDecodeError, KeyError, TypeError):
        return {}


SAMPLES = 1000
# Other scenarios than those of the evaluation job, whose seed is 0.
SEED = 1


def served_quality(url: str, references: Sequence[str], tour: Tour) -> Mapping[str, ReconstructionSummary]:
    """Ask for versions, without their validity filter and with it, and evaluate all on the same scenarios.

    Args:
        url: of the inference API.
        references: the versions, as the API takes them.
        tour: whose scenarios, and how many.

    Returns:
        By reference the summary over all scenarios of ``SAMPLES`` samples each; ``confident`` is as
        served, and None where too few samples came in some scenario.

    Raises:
        SamplerUnavailableError: the API does not answer.
        SamplerError: it refused a request.
    """
    stage = Stage(tour.world, Split.TEST, SEED)
    with SamplingClient(url, robot=robot_digest(stage.world)) as client:
        rows = [_rows(Scene(stage, index), client, references) for index in range(tour.scenarios)]
    return {one: summarise([row[one] for row in rows], np.random.default_rng(SEED)) for one in references}


def _rows(scene: Scene, client: SampleSource, references: Sequence[str]) -> dict[str, SceneQuality]:
    held_out = scene.free(SAMPLES, scene.rng(0))
    uniform = scene.quality(scene.space.sample_uniform(scene.rng(1), SAMPLES), held_out)
    real = scene.quality(scene.free(SAMPLES, scene.rng(2)), held_out)

    picture = picture_file_of(scene.scenario)

    def quality_of(reference: str) -> SceneQuality:
        queries = (SampleQuery(SAMPLES, scene.sampler_seed(), min_confidence=least) for least in (0.0, None))
        sampled, served = (client.answer(picture, query, reference).samples for query in queries)
        as_served = scene.quality(served.astype(np.float64), held_out) if len(served) == SAMPLES else None
        return SceneQuality(
            scene.index, scene.quality(sampled.astype(np.float64), held_out), uniform, real, as_served
        )

    return {reference: quality_of(reference) for reference in references}


PLANNING_SEED = 7
# What the command ends with when the planner found no path: an outcome, which it has printed and drawn.
NOT_SOLVED = 1


def plan_and_draw(
    url: str,
    folder: Path,
    environment: Mapping[str, str],
    show: Callable[[str], None],
    families: Sequence[str],
    options: Sequence[str] = (),
) -> list[Path]:
    """Plan one problem of each family and draw it; the pictures.

    Args:
        url: of the inference API.
        folder: for the pictures; made if it is not there.
        environment: of the command.
        show: takes the command's lines.
        families: of the problems.
        options: of the command besides, such as ``--robot`` and ``--model``.

    Raises:
        PlanningError: the command failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures = [folder / f"plan-{family}.png" for family in families]
    for family, picture in zip(families, pictures, strict=True):
        picture.unlink(missing_ok=True)
        # A process of its own: OMPL seeds its generator once a process.
        command = ["-m", "services.planner", "--api", url, *options, "--family", family]
        command += ["--seed", str(PLANNING_SEED), "--plot", str(picture)]
        show(f"$ python {shlex.join(command)}")
        code, _ = run_shown([sys.executable, *command], show, environment)
        # A crash ends with the same code, but draws nothing.
        if code not in (0, NOT_SOLVED) or not picture.is_file():
            raise PlanningError(
                f"the planner failed on the family {family}", got=f"exit code {code}, the lines above"
            )
    return pictures


def run_shown(
    command: Sequence[str], show: Callable[[str], None], environment: Mapping[str, str] | None = None
) -> tuple[int, str]:
    """Run a command and show its lines; its exit code and the last line."""
    last = ""
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        for line in process.stdout or ():
            last = line.rstrip()
            show(last)
    return process.returncode, last


def summary(
    training: TrainingResult,
    evaluation: EvaluationResult,
    quality: Mapping[str, ReconstructionSummary],
    scenarios: int,
    pictures: Sequence[Path],
    elapsed_s: float,
) -> str:
    """What the main job did and how good its version is."""
    verdict = "champion now" if evaluation.promoted else "not promoted, the champion stays"
    head = aligned(
        [
            ("version", f"{training.reference}, {verdict}"),
            ("run", training.run_id),
            ("digest", training.digest),
            ("time", f"{elapsed_s:.0f} s"),
        ]
    )
    reasons = "\n".join(f"  {reason}" for reason in evaluation.reasons)
    paths = "\n".join(f"  {path}" for path in pictures)
    return (
        f"{head}\nwhy\n{reasons}\n\n"
        f"{scenarios} unseen scenarios over HTTP, {SAMPLES} samples each, "
        f"drawn without the validity filter and as served; 95 % intervals over scenarios\n"
        f"{quality_table(quality)}\n\npictures\n{paths}"
    )


def quality_table(quality: Mapping[str, ReconstructionSummary]) -> str:
    """Precision, coverage and energy ratio of models by reference, beside uniform and real samples."""
    rows: list[tuple[str, ...]] = [("sampler", "precision", "coverage", "EDr")]
    for reference, summary in quality.items():
        name = f"{reference} (shipped)" if is_shipped(reference) else reference
        rows.append((name, *_cells(summary.sampler)))
        if summary.confident is not None:
            rows.append((f"{name}, as served", *_cells(summary.confident)))
    any_of_them = next(iter(quality.values()))
    rows += [("uniform", *_cells(any_of_them.uniform)), ("real samples", *_cells(any_of_them.real))]
    return aligned(rows)


def _cells(one: SamplerSummary) -> tuple[str, str, str]:
    return (_text(one.precision), _text(one.coverage), _text(one.edr))


def _text(interval: Interval) -> str:
    return f"{interval.estimate:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


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
    training = last_result(_run(jobs, tour.train, progress), TrainingResult)
    command = tour.evaluate.replace("{model}", training.reference)
    evaluation = last_result(_run(jobs, command, progress), EvaluationResult)
    progress.stage(f"waiting until the inference API serves {training.reference}")
    # The API's default is one robot's; a model of another one is asked for by its name.
    default = evaluation.promoted and training.model == MODEL_NAME
    wait_served(settings.api_url, training.reference, default=default)
    listed = listed_models(settings.api_url, training.model)
    both = tuple(name for name in (training.reference, tour.shipped) if name and name in listed)
    progress.stage(f"quality of {' and '.join(both)} over HTTP, on scenarios that nobody was trained on")
    quality = served_quality(settings.api_url, both, tour)
    progress.stage("planning with samples from POST /sample")
    pictures = _pictures(settings, tour, training, evaluation, progress)
    progress.stage("done")
    say(f"\n{summary(training, evaluation, quality, tour.scenarios, pictures, progress.elapsed_s)}")
    say(f"\n{addresses(settings)}\n\n{shell_help(settings)}\n\nThe services stay up; `make down` ends them.")
    flat = tour.world.sensor.extent_m is not None
    viewer = f"python -m services.planner.viewer --api {settings.api_url} --model {training.model}"
    say(f"\nLook at what was trained: {f'{settings.api_url}/' if flat else viewer}")


def _run(jobs: RayJobs, entrypoint: str, progress: Progress) -> str:
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
    # The default robot and the default model need no words.
    is_default = training.model == MODEL_NAME
    options = () if is_default else ("--robot", tour.robot, "--model", training.reference)
    pictures = plan_and_draw(settings.api_url, folder, environment, progress.line, tour.families, options)
    for run_id, names in ((training.run_id, training.figures), (evaluation.run_id, evaluation.figures)):
        pictures += fetch_pictures(settings.mlflow_url, run_id, names, folder)
    return pictures
