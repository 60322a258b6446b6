"""The report of an import: lines for people, JSON for programs, and a picture of spheres over surfaces."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cspace.worlds.spatial.arm import ready_rad
from cspace.worlds.spatial.poses import moved
from training.robots.covering import gaps_m
from training.robots.importing import Imported


def lines_of(imported: Imported) -> list[str]:
    """How well the spheres fit, joints, pairs that are held apart, what was left out."""
    lines = [f"{'part':<24}spheres  missed mm  missed %  sticks out mm  mean mm"]
    for name, fit in imported.fits.items():
        lines.append(
            f"{name:<24}{fit.spheres:>7}{1e3 * fit.missed_m:>11.2f}{100.0 * fit.missed_share:>10.2f}"
            f"{1e3 * fit.excess_m:>15.2f}{1e3 * fit.mean_excess_m:>9.2f}"
        )
    arm = imported.arm
    lines.append(f"{arm.name}: {arm.dim} joints, {arm.sphere_count} spheres, {len(arm.touching)} pairs")
    for joint in arm.joints:
        limits = joint.limits_rad
        lines.append(
            f"  {joint.name}: " + ("a circle" if limits is None else f"{limits[0]:g} to {limits[1]:g} rad")
        )
    lines += [f"  {one.name}, {one.kind}: held at {one.value:g}, {one.why}" for one in imported.held]
    lines.append(f"pairs by {'sampling' if imported.srdf is None else imported.srdf}")
    lines += [
        f"  {one.pair[0]} and {one.pair[1]}: overlap in {100.0 * one.share:.2f} % of configurations"
        f"{'' if one.kept else ', not held apart'}"
        for one in imported.touching
        if one.share is not None and (one.share > 0.0 or one.kept)
    ]
    return lines + [f"warning: {note}" for note in imported.notes]


def values_of(imported: Imported) -> dict[str, Any]:
    """Plain values for JSON."""
    arm = imported.arm
    return {
        "robot": arm.name,
        "joints": [{"name": joint.name, "limits_rad": joint.limits_rad} for joint in arm.joints],
        "held": [asdict(one) for one in imported.held],
        "parts": [
            {"name": part.name, "link": part.link, **asdict(imported.fits[part.name])} for part in arm.parts
        ],
        "srdf": None if imported.srdf is None else str(imported.srdf),
        "pairs": [asdict(one) for one in imported.touching],
        "warnings": list(imported.notes),
    }


def draw(imported: Imported, path: Path) -> None:
    """Write a picture, PNG: from three sides, the arm's surfaces where it waits, with its spheres over them.

    Points of a surface are green inside the spheres, red outside.
    """
    # A second that errors need not wait.
    from matplotlib.collections import EllipseCollection  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    arm = imported.arm
    frames = arm.link_frames(ready_rad(arm)[None])[0]
    spheres, points, missed = [], [], []
    for part in arm.parts:
        own, surface = np.asarray(part.spheres_m), imported.surfaces[part.name]
        missed.append(gaps_m(surface, own) > 0.0)
        points.append(moved(frames[part.link], surface))
        spheres.append(np.column_stack([moved(frames[part.link], own[:, :3]), own[:, 3]]))
    centres, dots, red = np.concatenate(spheres), np.concatenate(points), np.concatenate(missed)
    figure = Figure(figsize=(15, 5.5), layout="constrained")
    figure.suptitle(f"{arm.name}: {arm.sphere_count} spheres over its surfaces, where it waits")
    for axes, (x, y) in zip(figure.subplots(1, 3), ((0, 2), (1, 2), (0, 1)), strict=True):
        sizes = 2.0 * centres[:, 3]
        axes.add_collection(
            EllipseCollection(
                sizes, sizes, np.zeros(len(sizes)), units="xy", offsets=centres[:, (x, y)],
                offset_transform=axes.transData, facecolors="none", edgecolors="0.6", linewidths=0.3,
            )
        )  # fmt: skip
        axes.scatter(dots[:, x], dots[:, y], s=0.3, c=np.where(red, "tab:red", "tab:green"))
        axes.set(xlabel=f"{'xyz'[x]}, m", ylabel=f"{'xyz'[y]}, m", aspect="equal")
    figure.savefig(path, format="png")
