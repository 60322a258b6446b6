"""Model cards: what a version is for, on what it was measured, what it promises, and where it comes from."""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any

import pandas as pd

from cspace.bundle.spec import BundleSpec
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError
from cspace.files import replacing
from cspace.worlds import robot_digest, simulator_of
from services.evaluator import compare
from services.evaluator.tables import markdown
from services.names import TAG_PRESET, recorded_name, shown_name
from services.registry.entities import ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import decisions_of, utc
from services.registry.tracking import Tracking

# By task the measures that a card shows.
_MEASURES = {
    "reconstruction": ("precision", "coverage"),
    "head": ("accuracy", "calibration_error"),
    "planning": ("planning_success", "success", "edge_checks_ratio"),
}
_SAMPLERS = {"sampler": "all samples", "confident": "served samples", "learned": "", "": ""}


def make_card(model: ModelReference, registry: ModelRegistry, tracking: Tracking) -> str:
    """The card of a registered version, in Markdown, with the figures of its newest evaluation.

    Raises:
        ModelNotFoundError: there is no such version.
        BundleError: its bundle is damaged or answers otherwise here.
        RegistryError: the server is away or refuses.
    """
    version = model.look_up(registry)
    with tempfile.TemporaryDirectory(prefix="cspace-card-") as folder:
        spec = load_verified(registry.download(version, Path(folder) / "bundle"), version.digest).spec
    figures = _figures(version, registry, tracking)
    decisions = [
        f"- {utc(one.created_ms)}: {'promoted' if one.promoted else 'not promoted'}\n"
        + "\n".join(f"  - {reason}" for reason in one.reasons)
        for one in decisions_of(version)
    ]
    return (
        "\n\n".join(
            [
                f"# {', '.join((str(version), *version.aliases))}",
                markdown([("", ""), *_properties(version, spec)]),
                "## Figures",
                *figures,
                "## What it promises",
                _list(_promises(spec)),
                "## Limits",
                _list(_limits(spec)),
                "## Decisions",
                "\n".join(decisions) or "None yet.",
            ]
        )
        + "\n"
    )


def _properties(version: ModelVersion, spec: BundleSpec) -> list[tuple[str, str]]:
    world, made, families = spec.world, spec.provenance, simulator_of(spec.world).families
    given = {"configuration": "a picture", "path": "a picture, start and goal"}[spec.kind]
    changed = ", with changes" if made.git_dirty else ""
    seeds = ", ".join(f"{name} {seed}" for name, seed in made.seeds.items())
    rows = {
        "task": f"collision-free configurations for {given}",
        "robot": f"{shown_name(world, recorded_name(made.config))}, {spec.dim} joints, "
        f"digest {robot_digest(world)[:12]}",
        "pictures": _pictures(spec),
        "scenes": f"{world.kind} world, {families.uniform_obstacles}",
        "preset": version.tags.get(TAG_PRESET, ""),
        "data": f"SHA-256 {made.data_digest}" if made.data_digest else "",
        "seeds": seeds,
        "code": f"commit {made.git_commit}{changed}" if made.git_commit else "",
        "command": f"`{made.command}`" if made.command else "",
        "made": made.created or "",
        "run": version.run_id,
        "bundle": f"SHA-256 {version.digest}",
        "licence": _licence(),
    }
    return [(name, text) for name, text in rows.items() if text]


def _pictures(spec: BundleSpec) -> str:
    convention, extent_m = spec.world.sensor.convention, spec.world.sensor.extent_m
    if extent_m is not None:
        left, right, bottom, top = extent_m
        return (
            f"{spec.pixels} x {spec.pixels} RGB of the plane, x {left:g} to {right:g} m, "
            f"y {bottom:g} to {top:g} m"
        )
    cameras = convention["cameras"]
    counts, pixels, field_deg, away_m = (
        cameras[name] for name in ("count", "pixels", "field_deg", "distance_m")
    )
    return (
        f"depth pictures of {_range(counts)} cameras; in training {pixels[0]} x {pixels[1]} pixels, "
        f"field of view {_range(field_deg)} degrees, {_range(away_m)} m away; "
        f"voxels of {100.0 * convention['grid']['voxel_m']:g} cm"
    )


def _range(ends: Sequence[float]) -> str:
    low, high = ends
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def _promises(spec: BundleSpec) -> list[str]:
    threshold = spec.confidence_threshold
    found = [
        "Samples have no confidence."
        if threshold is None
        else f"A sample's confidence is the predicted probability that it is free. Served are those of at "
        f"least {threshold:g}, unless a request asks otherwise."
    ]
    if spec.kind == "configuration" and threshold is not None:
        found.append(
            "The confidence of plans is not calibrated."
            if spec.plan_calibration is None
            else "The confidence of plans is calibrated on validation scenes. A plan below "
            f"{spec.plan_confidence:g} is refused, unless a request asks otherwise."
        )
    return found


def _limits(spec: BundleSpec) -> list[str]:
    found = [
        "A confidence is a prediction, no guarantee. Check paths exactly before a robot moves.",
        "Scenes, cameras and mountings unlike those above lower quality and calibration.",
    ]
    if spec.novelty_quantiles is not None:
        found.append("The novelty of an answer says how unusual its picture is beside validation's.")
    if spec.world.sensor.extent_m is None:
        found.append("What no camera sees is guessed from what usually stands there.")
    return found


def _figures(version: ModelVersion, registry: ModelRegistry, tracking: Tracking) -> list[str]:
    try:
        found = compare.find(str(version), tracking, registry)
    except ConfigError:
        return ["Not evaluated yet."]
    shown = [cells for row in found.rows.to_dict("records") if (cells := _cells(row)) is not None]
    note = f"Evaluation {found.run.run_id}; intervals of 95 % by bootstrap over scenes or problems."
    return [markdown([("measure", "value"), *shown]), note]


def _cells(row: Mapping[str, Any]) -> tuple[str, str] | None:
    measure, sampler = row["measure"], row["sampler"]
    if measure not in _MEASURES.get(row["task"], ()) or sampler not in _SAMPLERS:
        return None
    of = filter(None, (row["split"], row["family"], _SAMPLERS[sampler]))
    name = "head accuracy" if measure == "accuracy" else measure.replace("_", " ")
    limits = "" if pd.isna(row["low"]) else f" [{row['low']:.3f}, {row['high']:.3f}]"
    count = "" if pd.isna(row["n"]) else f", n {row['n']}"
    return f"{name}, {', '.join(of)}", f"{row['value']:.3f}{limits}{count}"


def _licence() -> str:
    try:
        return metadata("cspace-sampler")["License-Expression"] or ""
    except PackageNotFoundError:
        return ""


def _list(lines: Sequence[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def make_parser() -> argparse.ArgumentParser:
    """Of the command's arguments."""
    parser = argparse.ArgumentParser(
        prog="python -m services.evaluator card",
        description="Print the model card of a version, in Markdown.",
        epilog="Exit codes: 0 printed, 1 the registry or the bundle failed, 2 wrong request.",
    )
    parser.add_argument("model", help="name, name@alias or name/version")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write it to a file instead")
    return parser


def write_card(card: str, path: Path) -> None:
    """Write a card; the file appears whole or not at all. Raises StorageError where it cannot."""
    with replacing(path, "the model card") as beside:
        beside.write_text(card, encoding="utf-8")
