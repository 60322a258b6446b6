"""An evaluation: one long table of values by model, scenario and metric, and the estimates made of it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd

from cspace.simulator import UNIFORM
from cspace.world import World
from cspace.worlds import simulator_of
from services.evaluator.measure import EVALUATED_SPLITS, Row, Setting, UnitResult
from services.evaluator.metrics import Metric, Task, metrics_of
from services.evaluator.statistics import Interval, summary_rng

VALIDATION, TEST = "validation", "test"
MAX_HEADLINE, MAX_METRICS = 12, 60
_PREFIXES = {"sampler": "", "learned": "", "confident": "served_", "uniform": "uniform_", "": ""}
_HEADLINE = ("precision", "coverage", "edr", "served_precision", "served_coverage", "planning_success")
_SCENE = ["family", "number", "seed"]
ESTIMATE_COLUMNS = ["task", "split", "family", "sampler", "measure", "value", "low", "high", "n"]


def table_of(results: Sequence[UnitResult], model: str) -> pd.DataFrame:
    """The rows of a model as a table, in an order that does not depend on that of the results."""
    rows = [(model, str(one.unit.split), *row) for one in results for row in one.rows]
    table = pd.DataFrame(rows, columns=["model", "split", *Row._fields])
    return table.sort_values(["split", "task", "sampler", *_SCENE], kind="stable", ignore_index=True)


@dataclass(frozen=True)
class Evaluation:
    """The values of a model and of its rivals. Validation decides, test is reported."""

    setting: Setting
    model: str
    table: pd.DataFrame
    cpu_seconds: float

    def select(self, split: str, task: Task, model: str | None = None) -> pd.DataFrame:
        """The rows of a split and task, by default of the evaluated model."""
        table = self.table
        return table[
            (table["split"] == split) & (table["task"] == task) & (table["model"] == (model or self.model))
        ]

    @cached_property
    def estimates(self) -> pd.DataFrame:
        """Every estimate of the model, its name in MLflow or an empty one, and whether it is a main one."""
        rows = [
            row
            for split in EVALUATED_SPLITS
            for task in Task
            for row in _estimates(self.select(split, task), str(split), task, self.setting)
        ]
        return pd.DataFrame(rows, columns=[*ESTIMATE_COLUMNS, "log_name", "main"]).astype({"n": "Int64"})

    def estimate(self, measure: str, sampler: str, family: str, split: str = VALIDATION) -> Interval | None:
        """One estimate of samples or planning; None where it was not made."""
        of = {"split": split, "family": family, "sampler": sampler, "measure": measure}
        found = self.estimates
        for column, value in of.items():
            found = found[found[column] == value]
        if found.empty:
            return None
        row = found.iloc[0]
        return Interval(float(row["value"]), float(row["low"]), float(row["high"]), int(row["n"]))


def estimates_of(
    rows: Sequence[Row], seed: int, task: Task = Task.RECONSTRUCTION
) -> dict[tuple[str, str], Interval]:
    """Estimates over uniform scenes, by sampler and measure."""
    table = pd.DataFrame(rows, columns=list(Row._fields))
    table = table[(table["task"] == task) & (table["family"] == UNIFORM)]
    found = _intervals(table, task, seed, UNIFORM)
    return {(sampler, measure): interval for sampler, _, measure, _, interval in found}


def _estimates(rows: pd.DataFrame, split: str, task: Task, setting: Setting) -> Iterator[tuple[object, ...]]:
    families = list(dict.fromkeys([*simulator_of(setting.world).families.names, *rows["family"]]))
    groups = [(family, rows[rows["family"] == family]) for family in families]
    if task is Task.PLANNING:
        # The success over all problems.
        groups.insert(0, ("", rows[rows["metric"] == "success"]))
    for family, mine in groups:
        for sampler, one, measure, main, interval in _intervals(mine, task, setting.seed, split, family):
            name = log_name(one, setting.world, split, family, sampler, measure) if main else ""
            limits = (interval.estimate, interval.low, interval.high, interval.count)
            yield (str(task), split, family, sampler, measure, *limits, name, main)


def _intervals(
    rows: pd.DataFrame, task: Task, seed: int, *use: str
) -> Iterator[tuple[str, Metric, str, bool, Interval]]:
    """Sampler, metric, measure, whether it is the metric's main one, and the estimate."""
    for one in metrics_of(task):
        values = {
            str(sampler): group.pivot(index=_SCENE, columns="part", values="value").to_numpy()
            for sampler, group in rows[rows["metric"] == one.name].groupby("sampler")
        }
        everywhere = max(map(len, values.values()), default=0)
        for sampler, found in values.items():
            # A sampler that is missing in some scene is not comparable.
            if len(found) == everywhere:
                rng = summary_rng(seed, task, *use, sampler, one.name)
                made = one.estimates(found, values.get("uniform", found), rng)
                for place, (measure, interval) in enumerate(made.items()):
                    yield sampler, one, measure, place == 0, interval


def log_name(one: Metric, world: World, split: str, family: str, sampler: str, measure: str) -> str:
    """The name of an estimate in MLflow, grouped by the part before ``/``; empty where it is not logged."""
    # Arms have many families, of which the decisive one's costs alone are logged.
    elsewhere = family not in ("", simulator_of(world).families.decisive)
    if sampler not in one.logged or (one.task is Task.PLANNING and elsewhere and one.name != "success"):
        return ""
    name = f"{_PREFIXES[sampler]}{measure}".replace("_ratio", "_saved")
    match one.task:
        case Task.PLANNING:
            return f"{split}/{family}/{name}" if family else f"{split}/planning_{name}"
        case Task.TOPOLOGY:
            return f"{split}/topology/{name}"
        case Task.HEAD:
            return f"{split}/head_{name}" if family == UNIFORM else ""
    if family == UNIFORM:
        return f"{split}/{name}"
    return f"{split}/{family}/{name}" if one.by_family and sampler != "uniform" else ""


def run_metrics(evaluation: Evaluation) -> dict[str, float]:
    """Metrics for an evaluation's page in MLflow, at most :data:`MAX_METRICS`."""
    logged = evaluation.estimates[evaluation.estimates["log_name"] != ""]
    return dict(zip(logged["log_name"], logged["value"], strict=True)) | {
        "cost/cpu_s": evaluation.cpu_seconds
    }


def headline(evaluation: Evaluation) -> dict[str, float]:
    """At most :data:`MAX_HEADLINE` metrics by which versions are chosen.

    Path models have those of the decisive family.
    """
    setting = evaluation.setting
    decisive = simulator_of(setting.world).families.decisive
    return {
        name: value
        for name, value in run_metrics(evaluation).items()
        if name.partition("/")[2] in _HEADLINE or (setting.paths and name.split("/")[1] == decisive)
    }
