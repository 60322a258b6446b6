"""What MLflow's UI says of the experiment: its kind, where to look, and saved views of its runs.

A view is what the UI keeps when somebody presses Share: a tag of the experiment that holds its state, opened
by ``viewStateShareKey`` in the address.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

KIND, CUSTOM_MODELS = "mlflow.experimentKind", "custom_model_development"
# Without it the UI opens its pages for language models, whatever an experiment's kind.
TRAINING = "workflowType=machine_learning"
NOTE = "mlflow.note.content"
VIEW = "mlflow.sharedViewState."
TAG_STAGE, TAG_JOB, TAG_PRESET, TAG_WORLD, TAG_MODEL = "stage", "job", "preset", "world", "model_version"

_QUALITY = ("precision", "served_precision", "coverage", "served_coverage", "edr", "planning_success")


@dataclass(frozen=True, slots=True)
class View:
    """A saved search of runs.

    Args:
        name: by which its address calls it.
        words: what it shows.
        search: which runs, in MLflow's words.
        tags: shown as columns; so the rest.
        params: parameters.
        metrics: metrics.
    """

    name: str
    words: str
    search: str
    tags: Sequence[str] = ()
    params: Sequence[str] = ()
    metrics: Sequence[str] = ()

    def state(self) -> str:
        """The state of the UI, as its tag holds it."""
        columns = [
            *(_column("tags", name) for name in self.tags),
            *(_column("params", name) for name in self.params),
            *(_column("metrics", name) for name in self.metrics),
        ]
        return json.dumps(
            {
                "searchFilter": self.search,
                "orderByKey": _column("attributes", "Created"),
                "orderByAsc": False,
                "selectedColumns": [_column("attributes", "Created"), *columns],
            }
        )


VIEWS = (
    View(
        "jobs",
        "every training job with its settings and the figures of its last evaluation",
        f"tags.{TAG_STAGE} LIKE '%-train'",
        (TAG_MODEL,),
        ("seed", "clusters.form", "local.steps"),
        tuple(f"validation/{name}" for name in _QUALITY),
    ),
    View(
        "trials",
        "the local trials of all jobs, with the parameters and last losses of each",
        f"tags.{TAG_STAGE} = 'local'",
        (TAG_JOB, TAG_PRESET),
        ("cluster", "share_of_data", "steps", "seed", "parameters"),
        ("critic_loss", "wasserstein_estimate", "generator_loss", "steps_per_s"),
    ),
    View(
        "evaluations",
        "every evaluation of a registered version, validation and test",
        f"tags.{TAG_STAGE} = 'evaluation'",
        (TAG_MODEL, "promoted"),
        ("seed", "scenarios"),
        tuple(f"{split}/{name}" for split in ("validation", "test") for name in _QUALITY[:5]),
    ),
    View(
        "planning",
        "the planning benchmarks",
        f"tags.{TAG_STAGE} = 'planning-benchmark'",
        ("protocol",),
        ("setting.seed",),
    ),
)


def described(experiment_id: str) -> Mapping[str, str]:
    """The experiment's tags: kind, description, views."""
    place = f"#/experiments/{experiment_id}/runs?{TRAINING}&viewStateShareKey="
    lines = "\n".join(f"- [{view.name}]({place}{view.name}): {view.words}; `{view.search}`" for view in VIEWS)
    note = (
        "Learned samplers for motion planning. A training job is a run with a child for each of its trials; "
        "an evaluation is a child of the job whose version it judges, and leaves its headline on the job, on "
        "the version and on its logged model.\n\n"
        f"Saved views of the runs:\n\n{lines}\n\n"
        "Choose runs and press Compare for parameters and metrics side by side; the image grid of the chart "
        "view sets galleries beside each other, the evaluation view tables. Models compares versions."
    )
    return {KIND: CUSTOM_MODELS, NOTE: note} | {f"{VIEW}{view.name}": view.state() for view in VIEWS}


def _column(kind: str, name: str) -> str:
    return f"{kind}.`{name}`"
