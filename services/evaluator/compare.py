"""Versions or runs side by side (``compare``), and the model card of one (``card``).

Each is shown by its last evaluation, whose table of estimates is read.
"""

import argparse
import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from cspace.bundle import load_verified
from cspace.errors import ConfigError
from cspace.files import replacing
from cspace.worlds import robot_digest
from services.evaluator.metrics import Task
from services.evaluator.report import MEASURES_TABLE
from services.evaluator.tables import aligned, markdown
from services.names import TAG_PRESET, recorded_name, shown_name
from services.registry import connect, tracking_uri
from services.registry.entities import FoundRun, ModelReference
from services.registry.models import ModelRegistry
from services.registry.promotion import decisions_of, utc
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
    run: FoundRun
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
                return Compared(title, one, rows.astype({"n": "Int64"}))
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


def compare_csv(compared: Sequence[Compared]) -> str:
    """All estimates in long form: one line each of every one compared."""
    rows = [one.rows.assign(compared=one.title, run_id=one.run.run_id) for one in compared]
    columns = ["compared", "run_id", *_KEY, "value", "low", "high", "n"]
    return str(pd.concat(rows)[columns].to_csv(index=False, lineterminator="\n"))


def write_comparison(compared: Sequence[Compared], folder: Path, *, everything: bool = False) -> None:
    """``comparison.txt``, ``.md`` and ``.csv`` in a folder."""
    table = compare_table(compared, everything=everything)
    texts = {"txt": aligned(table) + "\n", "md": markdown(table) + "\n", "csv": compare_csv(compared)}
    for ending, text in texts.items():
        path = folder / f"comparison.{ending}"
        with replacing(path, str(path)) as beside:
            path.parent.mkdir(parents=True, exist_ok=True)
            beside.write_text(text, encoding="utf-8")


def main(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Compare, print, and keep it where a folder is named."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator compare",
        description="The last evaluations of versions or runs side by side.",
        epilog="Exit codes: 0 compared; 1 the registry failed; 2 one is not there or was not evaluated.",
    )
    parser.add_argument("what", nargs="+", help="name/version, name@alias, or a run's id")
    parser.add_argument("--all", action="store_true", help="every estimate (default: the deciding ones)")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help="keep it as text, Markdown and CSV")
    options = parser.parse_args(arguments)
    found = [find(text, *connect(tracking_uri(environment))) for text in options.what]
    print(aligned(compare_table(found, everything=options.all)))
    if options.out is not None:
        write_comparison(found, options.out, everything=options.all)
    return 0


def make_card(model: ModelReference, tracking: Tracking, registry: ModelRegistry) -> str:
    """The card of a registered version, in Markdown: lineage, figures of its last evaluation, decisions."""
    version = registry.look_up(model)
    with tempfile.TemporaryDirectory(prefix="cspace-card-") as folder:
        spec = load_verified(registry.download(version, Path(folder) / "bundle"), version.digest).spec
    made, robot = spec.provenance, shown_name(spec.world, recorded_name(spec.provenance.config))
    least = spec.plan_confidence if spec.plan_calibration is not None else spec.confidence_threshold
    properties = {
        "task": f"collision-free configurations ({spec.kind})",
        "robot": f"{robot}, {spec.dim} joints, digest {robot_digest(spec.world)[:12]}",
        "scenes": f"{spec.world.kind} world",
        "lowest confidence": "none" if least is None else f"{least:g}",
        "preset": version.tags.get(TAG_PRESET, ""),
        "data": f"SHA-256 {made.data_digest}" if made.data_digest else "",
        "code": f"commit {made.git_commit}" if made.git_commit else "",
        "command": f"`{made.command}`" if made.command else "",
        "run": version.run_id,
        "bundle": f"SHA-256 {version.digest}",
    }
    figures = "Not evaluated yet."
    with suppress(ConfigError):
        figures = markdown(compare_table([find(str(version), tracking, registry)]))
    decisions = [
        "\n  - ".join([f"- {utc(one.created_ms)}: {'' if one.promoted else 'not '}promoted", *one.reasons])
        for one in decisions_of(version)
    ]
    parts = [
        f"# {', '.join((str(version), *version.aliases))}",
        markdown([("", ""), *((name, text) for name, text in properties.items() if text)]),
        "A confidence is a prediction, no guarantee. Check paths exactly before a robot moves.",
        f"## Figures\n\n{figures}",
        "## Decisions\n\n" + ("\n".join(decisions) or "None yet."),
    ]
    return "\n\n".join(parts) + "\n"


def print_card(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Print a card."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator card",
        description="Print the model card of a version, in Markdown.",
        epilog="Exit codes: 0 printed, 1 the registry or the bundle failed, 2 wrong request.",
    )
    parser.add_argument("model", help="name, name@alias or name/version")
    options = parser.parse_args(arguments)
    print(make_card(ModelReference.parse(options.model), *connect(tracking_uri(environment))), end="")
    return 0
