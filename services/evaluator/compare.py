"""Versions or runs side by side: ``python -m services.evaluator compare cspace-sampler/1 cspace-sampler/2``.

Each is shown by its last evaluation, whose table of estimates is read.
"""

import argparse
import json
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from cspace.errors import ConfigError, RegistryError, StorageError
from cspace.files import make_output_folder, read_bounded, replacing
from services.evaluator.evaluation.measured import RECONSTRUCTION
from services.evaluator.evaluation.report import MEASURES_TABLE
from services.evaluator.tables import Table, aligned, markdown
from services.registry.entities import FoundRun, ModelReference
from services.registry.models import ModelRegistry
from services.registry.tracking import Tracking

_RUN_ID = re.compile(r"[0-9a-f]{32}")
_DIGEST = "model_digest"
# A table of an evaluation has some 100 KiB.
MAX_TABLE_BYTES = 16 * 2**20
_KEY = ["split", "task", "family", "sampler", "measure"]
_SHOWN = ("precision", "coverage", "edr", "knn_precision", "knn_recall")
_PLANNING = ("planning_success", "iterations_ratio", "edge_checks_ratio", "success")


@dataclass(frozen=True, slots=True)
class Compared:
    """One of those that are compared.

    Args:
        title: the version, or the run.
        run: the evaluation's.
        rows: its estimates, as the evaluation's table has them.
    """

    title: str
    run: FoundRun
    rows: pd.DataFrame


def find(text: str, runs: Tracking, registry: ModelRegistry) -> Compared:
    """The last evaluation of a version, or of a run.

    Args:
        text: ``name/version``, ``name@alias``, or the id of an evaluation's or a training's run.
        runs: where evaluations are found.
        registry: where versions are.

    Raises:
        ConfigError: it was never evaluated.
        ModelNotFoundError: there is no such version.
        RegistryError: there is no such run, or its table is damaged or too large.
    """
    if _RUN_ID.fullmatch(text):
        run = runs.run(text)
        found = [run] if _DIGEST in run.tags else [one for one in runs.children(text) if _DIGEST in one.tags]
        title = run.name
    else:
        version = ModelReference.parse(text).look_up(registry)
        evaluations = runs.children(version.run_id)
        found = [one for one in evaluations if one.tags.get(_DIGEST) == version.digest]
        title = str(version)
    for one in found:
        rows = _rows(runs, one)
        if rows is not None:
            return Compared(title, one, rows)
    raise ConfigError(
        f"{text} was not evaluated",
        expected="a version with a finished evaluation, or the run of one",
        got="none",
        remedy=f"python -m services.evaluator --model {text}",
    )


def compare_table(compared: Sequence[Compared], *, everything: bool = False) -> Table:
    """One row an estimate, one column each: value and limits.

    Args:
        compared: in the order of the columns.
        everything: all estimates; else those of uniform scenes and of planning that versions are chosen by.
    """
    columns = [one.rows.set_index(_KEY)["shown"].rename(one.title) for one in compared]
    table = pd.concat(columns, axis=1, sort=False).fillna("-").reset_index()
    table = table if everything else table[_is_shown(table)]
    return [list(table.rename(columns={"sampler": "samples"})), *table.to_numpy().tolist()]


def compare_csv(compared: Sequence[Compared]) -> str:
    """All estimates in long form: one line each of every one compared."""
    rows = [one.rows.assign(compared=one.title, run_id=one.run.run_id) for one in compared]
    columns = ["compared", "run_id", *_KEY, "value", "low", "high", "n"]
    return str(pd.concat(rows)[columns].to_csv(index=False, lineterminator="\n"))


def write_comparison(compared: Sequence[Compared], folder: Path, *, everything: bool = False) -> None:
    """``comparison.txt``, ``.md`` and ``.csv`` in a folder.

    Raises:
        StorageError: it can not be written.
    """
    table = compare_table(compared, everything=everything)
    texts = {"txt": aligned(table), "md": markdown(table), "csv": compare_csv(compared).rstrip("\n")}
    try:
        make_output_folder(folder)
    except OSError as error:
        raise StorageError(f"the folder {folder} can not be made", got=str(error)) from error
    for ending, text in texts.items():
        path = folder / f"comparison.{ending}"
        with replacing(path, str(path)) as beside:
            beside.write_text(f"{text}\n", encoding="utf-8")


def make_parser() -> argparse.ArgumentParser:
    """The parser of the command."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator compare",
        description="The last evaluations of versions or runs side by side.",
        epilog="Exit codes: 0 compared; 1 the registry failed; 2 one is not there or was not evaluated.",
    )
    parser.add_argument("what", nargs="+", help="name/version, name@alias, or a run's id")
    parser.add_argument("--all", action="store_true", help="every estimate (default: the deciding ones)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep it as text, Markdown and CSV")
    return parser


def _rows(runs: Tracking, run: FoundRun) -> pd.DataFrame | None:
    with tempfile.TemporaryDirectory(prefix="cspace-compare-") as folder:
        path = runs.file(run.run_id, f"tables/{MEASURES_TABLE}.json", Path(folder))
        if path is None:
            return None
        data = read_bounded(path, MAX_TABLE_BYTES, RegistryError)
    try:
        table = json.loads(data)
        rows = pd.DataFrame(table["data"], columns=table["columns"])
        return rows[["shown", *_KEY, "value", "low", "high", "n"]].astype({"n": "Int64"})
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise RegistryError(
            f"the evaluation {run.run_id} has a damaged table",
            expected=f"{MEASURES_TABLE} as the evaluator writes it",
            got=repr(error)[:200],
            remedy="evaluate the version again",
        ) from error


def _is_shown(table: pd.DataFrame) -> pd.Series:
    scenes = (table["task"] == RECONSTRUCTION) & (table["family"] == "uniform")
    scenes &= table["sampler"].isin(["sampler", "confident"]) & table["measure"].isin(_SHOWN)
    return scenes | ((table["task"] != RECONSTRUCTION) & table["measure"].isin(_PLANNING))
