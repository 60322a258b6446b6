"""Versions or runs side by side.

Each is shown by its last evaluation, whose table of estimates is read.
"""

import argparse
import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from cspace.errors import ConfigError
from services.evaluator.metrics import Task
from services.evaluator.report import MEASURES_TABLE
from services.registry import connect, tracking_uri
from services.registry.entities import ModelReference
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

_RUN_ID = re.compile(r"[0-9a-f]{32}")
_DIGEST = "model_digest"
_KEY = ["split", "task", "family", "sampler", "measure"]
_SHOWN = ("precision", "coverage", "edr", "knn_precision", "knn_recall")
_PLANNING = ("success", "iterations_ratio", "edge_checks_ratio")


@dataclass(frozen=True, slots=True)
class Compared:
    """One of those that are compared: version or run in words, its evaluation's run, and the estimates."""

    title: str
    run_id: str
    rows: pd.DataFrame


def find(text: str, runs: Tracking, registry: ModelRegistry) -> Compared:
    """The last evaluation of ``name/version``, ``name@alias``, or the run of an evaluation or a training."""
    if _RUN_ID.fullmatch(text):
        run = runs.run(text)
        found = [run] if _DIGEST in run.tags else [one for one in runs.children(text) if _DIGEST in one.tags]
        title = run.name
    else:
        version = registry.look_up(ModelReference.parse(text))
        found = [one for one in runs.children(version.run_id) if one.tags.get(_DIGEST) == version.digest]
        title = str(version)
    for one in found:
        with tempfile.TemporaryDirectory(prefix="cspace-compare-") as folder:
            path = runs.file(one.run_id, f"tables/{MEASURES_TABLE}.json", Path(folder))
            if path is not None:
                table = json.loads(path.read_bytes())
                rows = pd.DataFrame(table["data"], columns=table["columns"])
                return Compared(title, one.run_id, rows.astype({"n": "Int64"}))
    raise ConfigError(
        f"{text} was not evaluated",
        expected="a version with a finished evaluation, or the run of one",
        got="none",
        remedy=f"python -m services.evaluator --model {text}",
    )


def compare_table(compared: Sequence[Compared], *, everything: bool = False) -> pd.DataFrame:
    """One row an estimate, one column each: all, or those of uniform scenes and of planning that decide."""
    columns = [one.rows.set_index(_KEY)["shown"].rename(one.title) for one in compared]
    table = pd.concat(columns, axis=1, sort=False).fillna("-").reset_index()
    scenes = (table["task"] == Task.RECONSTRUCTION) & (table["family"] == "uniform")
    scenes &= table["sampler"].isin(["sampler", "confident"]) & table["measure"].isin(_SHOWN)
    planning = (table["task"] == Task.PLANNING) & table["measure"].isin(_PLANNING)
    planning &= table["sampler"].isin(["learned", "confident"])
    return table if everything else table[scenes | planning]


def write_comparison(compared: Sequence[Compared], folder: Path, *, everything: bool = False) -> None:
    """``comparison.md``, and all estimates in long form as ``comparison.csv``, in a folder."""
    table = compare_table(compared, everything=everything)
    rows = [one.rows.assign(compared=one.title, run_id=one.run_id) for one in compared]
    columns = ["compared", "run_id", *_KEY, "value", "low", "high", "n"]
    folder.mkdir(parents=True, exist_ok=True)
    table.to_markdown(folder / "comparison.md", index=False, disable_numparse=True)
    pd.concat(rows)[columns].to_csv(folder / "comparison.csv", index=False)


def main(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Compare, print, and keep it where a folder is named."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator compare",
        description="The last evaluations of versions or runs side by side.",
        epilog="Exit codes: 0 compared; 1 the registry failed; 2 one is not there or was not evaluated.",
    )
    parser.add_argument("what", nargs="+", help="name/version, name@alias, or a run's id")
    parser.add_argument("--all", action="store_true", help="every estimate (default: the deciding ones)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep it as Markdown and CSV")
    options = parser.parse_args(arguments)
    found = [find(text, *connect(tracking_uri(environment))) for text in options.what]
    print(compare_table(found, everything=options.all).to_string(index=False))
    if options.out is not None:
        write_comparison(found, options.out, everything=options.all)
    return 0
