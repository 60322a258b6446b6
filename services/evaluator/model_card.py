"""Model cards: what a version is for, on what it was measured, what it promises, and where it comes from."""

import argparse
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import pandas as pd

from cspace.bundle.spec import BundleSpec
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError
from cspace.files import replacing
from cspace.worlds import robot_digest, simulator_of
from services.evaluator import compare
from services.evaluator.report import shown
from services.evaluator.tables import markdown
from services.names import TAG_PRESET, recorded_name, shown_name
from services.registry import connect, tracking_uri
from services.registry.entities import ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import decisions_of, utc
from services.registry.tracking import Tracking

# By task the measures that a card shows.
_MEASURES = {
    "reconstruction": ("precision", "coverage"),
    "head": ("accuracy", "calibration_error"),
    "planning": ("success", "edge_checks_ratio"),
}
_SAMPLERS = {"sampler": "all samples", "confident": "served samples", "learned": "", "": ""}


def make_card(model: ModelReference, registry: ModelRegistry, tracking: Tracking) -> str:
    """The card of a registered version, in Markdown, with the figures of its newest evaluation."""
    version = registry.look_up(model)
    with tempfile.TemporaryDirectory(prefix="cspace-card-") as folder:
        spec = load_verified(registry.download(version, Path(folder) / "bundle"), version.digest).spec
    decisions = [
        f"- {utc(one.created_ms)}: {'promoted' if one.promoted else 'not promoted'}\n"
        + "\n".join(f"  - {reason}" for reason in one.reasons)
        for one in decisions_of(version)
    ]
    parts = [
        f"# {', '.join((str(version), *version.aliases))}",
        markdown([("", ""), *((name, text) for name, text in _properties(version, spec).items() if text)]),
        "## Figures",
        *_figures(version, registry, tracking),
        "## What it promises",
        "\n".join(f"- {line}" for line in _promises(spec)),
        "## Decisions",
        "\n".join(decisions) or "None yet.",
    ]
    return "\n\n".join(parts) + "\n"


def _properties(version: ModelVersion, spec: BundleSpec) -> dict[str, str]:
    world, made = spec.world, spec.provenance
    given = {"configuration": "a picture", "path": "a picture, start and goal"}[spec.kind]
    changed = ", with changes" if made.git_dirty else ""
    robot = shown_name(world, recorded_name(made.config))
    return {
        "task": f"collision-free configurations for {given}",
        "robot": f"{robot}, {spec.dim} joints, digest {robot_digest(world)[:12]}",
        "pictures": _pictures(spec),
        "scenes": f"{world.kind} world, {simulator_of(world).families.uniform_obstacles}",
        "preset": version.tags.get(TAG_PRESET, ""),
        "data": f"SHA-256 {made.data_digest}" if made.data_digest else "",
        "seeds": ", ".join(f"{name} {seed}" for name, seed in made.seeds.items()),
        "code": f"commit {made.git_commit}{changed}" if made.git_commit else "",
        "command": f"`{made.command}`" if made.command else "",
        "made": made.created or "",
        "run": version.run_id,
        "bundle": f"SHA-256 {version.digest}",
        "licence": metadata("cspace-sampler")["License-Expression"] or "",
    }


def _pictures(spec: BundleSpec) -> str:
    convention, extent_m = spec.world.sensor.convention, spec.world.sensor.extent_m
    if extent_m is not None:
        left, right, low, high = extent_m
        place = f"x {left:g} to {right:g} m, y {low:g} to {high:g} m"
        return f"{spec.pixels} x {spec.pixels} RGB of the plane, {place}"
    cameras = ", ".join(f"{name} {'-'.join(map(str, ends))}" for name, ends in convention["cameras"].items())
    return f"depth pictures; {cameras}; voxels of {convention['grid']['voxel_m']:g} m"


def _promises(spec: BundleSpec) -> Iterator[str]:
    if spec.confidence_threshold is not None:
        least = spec.confidence_threshold
        yield f"Confidence predicts that a sample is free; samples below {least:g} are not served."
    if spec.kind == "configuration" and spec.plan_calibration is not None:
        least = spec.plan_confidence
        yield f"The confidence of plans is calibrated on validation; below {least:g} a plan is refused."
    yield "A confidence is a prediction, no guarantee. Check paths exactly before a robot moves."
    yield "Scenes, cameras and mountings unlike those above lower quality and calibration."


def _figures(version: ModelVersion, registry: ModelRegistry, tracking: Tracking) -> list[str]:
    try:
        found = compare.find(str(version), tracking, registry)
    except ConfigError:
        return ["Not evaluated yet."]
    rows = [cells for row in found.rows.to_dict("records") if (cells := _cells(row)) is not None]
    note = f"Evaluation {found.run.run_id}; intervals of 95 % by bootstrap over scenes or problems."
    return [markdown([("measure", "value"), *rows]), note]


def _cells(row: Mapping[str, Any]) -> tuple[str, str] | None:
    measure, sampler = row["measure"], row["sampler"]
    if measure not in _MEASURES.get(row["task"], ()) or sampler not in _SAMPLERS:
        return None
    of = filter(None, (row["split"], row["family"], _SAMPLERS[sampler]))
    name = "head accuracy" if measure == "accuracy" else measure.replace("_", " ")
    count = "" if pd.isna(row["n"]) else f", n {row['n']}"
    return f"{name}, {', '.join(of)}", f"{shown(row['value'], row['low'], row['high'], '.3f')}{count}"


def main(arguments: Sequence[str], environment: Mapping[str, str]) -> int:
    """Print a card, or write it to a file."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator card",
        description="Print the model card of a version, in Markdown.",
        epilog="Exit codes: 0 printed, 1 the registry or the bundle failed, 2 wrong request.",
    )
    parser.add_argument("model", help="name, name@alias or name/version")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write it to a file instead")
    options = parser.parse_args(arguments)
    tracking, registry = connect(tracking_uri(environment))
    card = make_card(ModelReference.parse(options.model), registry, tracking)
    if options.out is None:
        print(card, end="")
    else:
        with replacing(options.out, "the model card") as beside:
            beside.write_text(card, encoding="utf-8")
    return 0
