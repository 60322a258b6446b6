"""A serial arm from its description: chain, spheres for its links, pairs of links that can touch, report."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import MAX_OVERLAP_M, MAX_SPHERES, Part, SerialArm
from cspace.worlds.spatial.collision import CollisionChecker
from cspace.worlds.spatial.obstacles import Obstacles
from cspace.worlds.spatial.poses import moved
from cspace.worlds.spatial.sensor import VOXEL_M, grid_of
from training.robots.chain import Chain, Held, Limits, read_chain
from training.robots.description import (
    Description,
    JointLimit,
    find_srdf,
    read_description,
    read_joint_limits,
    read_srdf,
)
from training.robots.spheres import (
    Allowances,
    Fit,
    Floats,
    Solid,
    cover,
    measure,
    read_solids,
)

Pairs = set[frozenset[str]]
# What is drawn depends on the description alone.
_SEED = 20261123
# Of written places, m.
_DIGITS = 5
# Share of what spheres stick out at most; chosen by the meshes of the shipped arms.
_OVERLAP = 0.5
# As MoveIt's setup assistant counts a pair that always collides.
ALWAYS_SHARE = 0.95
_SAMPLES = 4000
# Of measured fits, for points between those that the cover was made for.
_TOLERANCE_M = 0.0005
# Where spheres stick out by so many times what they may, a surface is open.
_OPEN = 2.0


@dataclass(frozen=True, slots=True)
class Touching:
    """A pair of parts: in which share of samples it overlaps, whether it is held apart, and why."""

    pair: tuple[str, str]
    share: float | None
    kept: bool
    why: str


@dataclass(frozen=True, slots=True)
class Imported:
    """A robot, fits by the names of its parts, pairs of parts, held joints, warnings, and the SRDF file."""

    arm: SerialArm
    fits: Mapping[str, Fit]
    touching: tuple[Touching, ...]
    held: tuple[Held, ...]
    notes: tuple[str, ...]
    srdf: Path | None

    def lines(self) -> list[str]:
        """How well the spheres fit, joints, pairs that are held apart, what was left out."""
        lines = [f"{'part':<24}spheres  missed mm  sticks out mm"]
        for name, fit in self.fits.items():
            lines.append(f"{name:<24}{fit.spheres:>7}{1e3 * fit.missed_m:>11.2f}{1e3 * fit.excess_m:>15.2f}")
        arm = self.arm
        lines.append(f"{arm.name}: {arm.dim} joints, {arm.sphere_count} spheres, {len(arm.touching)} pairs")
        for joint in arm.joints:
            low, high = joint.limits_rad or (None, None)
            lines.append(f"  {joint.name}: {'a circle' if low is None else f'{low:g} to {high:g} rad'}")
        lines += [f"  {one.name}, {one.kind}: held at {one.value:g}, {one.why}" for one in self.held]
        lines.append(f"pairs by {'sampling' if self.srdf is None else self.srdf}")
        lines += [
            f"  {one.pair[0]} and {one.pair[1]}: overlap in {100.0 * one.share:.2f} % of configurations"
            f"{'' if one.kept else ', not held apart'}"
            for one in self.touching
            if one.share is not None and (one.share > 0.0 or one.kept)
        ]
        return lines + [f"warning: {note}" for note in self.notes]


def import_robot(
    urdf: Path,
    *,
    name: str | None = None,
    srdf: Path | None = None,
    tip: str | None = None,
    locked: Mapping[str, float] | None = None,
    limits: Mapping[str, Limits] | None = None,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
    without: Sequence[str] = (),
    kept: Sequence[Sequence[str]] = (),
    allowances: Allowances | None = None,
    ready_rad: tuple[float, ...] | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> Imported:
    """The arm that a URDF file describes.

    Where they are None, the name is the description's, the SRDF file is that beside it, the tip is the last
    link before a gripper or the first branch, and the arm waits in the middle of its limits. Values of
    ``locked`` are rad or m, ``limits`` rad, None for a circle. ``arguments`` are xacro's. ``report`` takes
    each part's name before its spheres are sought.
    """
    description = read_description(urdf, packages or {}, arguments or {})
    srdf, allowances = srdf or find_srdf(urdf), allowances or Allowances()
    disabled, notes = ({}, []) if srdf is None else read_srdf(srdf, description.links)
    notes = [*description.notes, *notes]
    rows = read_joint_limits(srdf or urdf, [joint.name for joint in description.joints.values()])
    limits = _limits(rows, limits or {}, notes)
    gone = description.behind(without)
    chain = read_chain(description, tip, locked or {}, limits, gone)
    mentioned = {link for pair in kept for link in pair} | set(without)
    if unknown := sorted(mentioned - set(description.links)):
        known = f"some of {sorted(description.links)}"
        raise ScenarioError("links are unknown", expected=known, got=str(unknown))
    # First, for spheres take a while.
    rates = _rates(description, chain, rows)
    jointed = SerialArm(name or description.name, chain.joints, (), (), chain.tool, ready_rad, *rates)
    solids = _solids(description, chain, urdf, packages or {}, gone, notes)
    parts, fits = [], {}
    for link, own in solids.items():
        report(link)
        number, frame = chain.frames[link]
        where, allowed = f"link {link}", allowances.of(own)
        spheres, fits[link] = _spheres(own, where, allowed, notes)
        if allowed.excess_m > allowances.excess_m:
            notes.append(f"{where} is large: spheres stick out by up to {1e3 * allowed.excess_m:.0f} mm")
        rows = np.round(np.column_stack([moved(frame, spheres[:, :3]), spheres[:, 3]]), _DIGITS).tolist()
        overlap_m = min(round(_OVERLAP * fits[link].excess_m, _DIGITS), MAX_OVERLAP_M)
        parts.append(Part(link, number, tuple((x, y, z, radius) for x, y, z, radius in rows), overlap_m))
    if (count := sum(fit.spheres for fit in fits.values())) > MAX_SPHERES:
        raise ScenarioError(
            "the robot needs too many spheres",
            expected=f"at most {MAX_SPHERES}",
            got=f"{count}: " + ", ".join(f"{name} {fit.spheres}" for name, fit in fits.items()),
            remedy="raise --excess-mm, or leave out parts that the arm cannot reach with --without LINK",
        )
    bare = replace(jointed, parts=tuple(parts))
    neighbours, kept_pairs = _neighbours(description, set(fits)), {frozenset(pair) for pair in kept}
    touching = _touching(bare, neighbours, disabled, kept_pairs)
    arm = replace(bare, touching=tuple(one.pair for one in touching if one.kept))
    if (voxel_m := grid_of(arm).voxel_m) > VOXEL_M:
        notes.append(
            f"the arm is large: voxels have {1e3 * voxel_m:.0f} mm instead of {1e3 * VOXEL_M:.0f} mm"
        )
    return Imported(arm, fits, touching, chain.held, (*chain.notes, *notes), srdf)


def _limits(
    rows: Mapping[str, JointLimit], given: Mapping[str, Limits], notes: list[str]
) -> dict[str, Limits]:
    """Limits that replace the description's: MoveIt's, of which the notes tell, and those that are given."""
    by_file = {
        name: (row.min_position, row.max_position) for name, row in rows.items() if row.has_position_limits
    }
    if taken := sorted(set(by_file) - set(given)):
        notes.append(f"limits of joint_limits.yaml are taken: {', '.join(taken)}")
    return {**by_file, **given}


def _rates(
    description: Description, chain: Chain, rows: Mapping[str, JointLimit]
) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """Largest velocities, MoveIt's or else the description's, and accelerations; None unless all have one."""
    own = {joint.name: joint.limit for joint in description.joints.values()}
    velocities, accelerations = [], []
    for name in (joint.name for joint in chain.joints):
        row = rows.get(name, JointLimit())
        by_urdf = own[name].velocity if own[name] is not None else None
        velocities.append(row.max_velocity if row.has_velocity_limits else by_urdf or 0.0)
        accelerations.append(row.max_acceleration if row.has_acceleration_limits else 0.0)
    found = (tuple(rates) if min(rates) > 0.0 else None for rates in (velocities, accelerations))
    return next(found), next(found)


def _solids(
    description: Description,
    chain: Chain,
    urdf: Path,
    packages: Mapping[str, Path],
    gone: Collection[str],
    notes: list[str],
) -> dict[str, list[Solid]]:
    """The solids of each link that has some and is not left out; warnings go to the notes."""
    folder, pictured = urdf.resolve().parent, []
    solids: dict[str, list[Solid]] = {}
    for name in chain.frames:
        if name in gone:
            continue
        link = description.links[name]
        found, more = read_solids(link.collisions or link.visuals, f"link {name}", folder, packages)
        notes += more
        if found:
            solids[name] = found
        if found and not link.collisions:
            pictured.append(name)
    if gone:
        notes.append(f"left out by --without: {', '.join(sorted(gone))}")
    if pictured:
        notes.append(f"links without collision shapes, whose visual shapes are taken: {', '.join(pictured)}")
    if not solids:
        raise ScenarioError(
            "no link has a shape, so the arm would never collide",
            expected="<collision> or <visual> with a size",
            got="; ".join([f"none in {urdf.name}", *notes]),
        )
    return solids


def _spheres(solids: list[Solid], where: str, allowances: Allowances, notes: list[str]) -> tuple[Floats, Fit]:
    """Spheres (K, 4) in the frame of the link, and how well they fit; warnings go to the notes."""
    rng, exact = np.random.default_rng(_SEED), [one.sphere for one in solids if one.sphere is not None]
    if len(exact) == len(solids):
        return np.stack(exact), measure(solids, np.stack(exact), rng)
    hollow = [one.is_hollow(allowances.excess_m, np.random.default_rng(_SEED)) for one in solids]
    for filled in (hollow, [True] * len(solids)):
        shapes = [one.hull() if fill else one for one, fill in zip(solids, filled, strict=True)]
        spheres = cover(shapes, allowances, rng)
        fit = measure(shapes, spheres, rng)
        is_covered = fit.missed_m <= allowances.slack_m + _TOLERANCE_M
        if is_covered and fit.excess_m <= _OPEN * allowances.excess_m:
            break
    if any(filled):
        notes.append(f"{where} has thin walls or is open: spheres cover its convex hull")
    if fit.excess_m > allowances.excess_m + _TOLERANCE_M:
        notes.append(f"{where} has a folded surface: spheres stick out {1e3 * fit.excess_m:.1f} mm")
    return spheres, fit


def _neighbours(description: Description, parts: set[str]) -> Pairs:
    """Pairs of parts that a joint connects, also by links without shapes, as MoveIt counts them."""
    near: dict[str, set[str]] = {name: set() for name in description.links}
    for joint in description.joints.values():
        near[joint.parent].add(joint.child)
        near[joint.child].add(joint.parent)
    for name in set(near) - parts:
        around = near.pop(name)
        for one in around:
            near[one] = (near[one] | around) - {one, name}
    return {frozenset((one, other)) for one, others in near.items() for other in others}


def _touching(
    arm: SerialArm, neighbours: Pairs, disabled: Mapping[frozenset[str], str], kept: Pairs
) -> tuple[Touching, ...]:
    """All pairs of parts of different links, and which of them are held apart.

    Neighbours, pairs that the SRDF disables, those whose spheres never overlap in sampled configurations, and
    those that nearly always do are not.
    """
    space, rng = arm.space, np.random.default_rng(_SEED)
    sampled = rng.uniform(space.lower, space.upper, (_SAMPLES, arm.dim))
    found = []
    for first, second in combinations(arm.parts, 2):
        names, pair = (first.name, second.name), frozenset((first.name, second.name))
        if first.link == second.link:
            continue
        if pair not in kept and (pair in neighbours or pair in disabled):
            why = "neighbours" if pair in neighbours else f"SRDF: {disabled[pair]}"
            found.append(Touching(names, None, kept=False, why=why))
            continue
        distances = CollisionChecker(replace(arm, touching=(names,)), Obstacles()).clearance(sampled)
        share = float(np.mean(distances < 0.0))
        if pair in kept:
            why = "--keep"
        elif share == 0.0:
            why = "never overlap"
        else:
            why = "can touch" if share < ALWAYS_SHARE else "nearly always overlap"
        found.append(Touching(names, share, why in {"--keep", "can touch"}, why))
    return tuple(found)
