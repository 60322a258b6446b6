"""A serial arm from its description: the chain, spheres for its pieces, and the pairs that can touch."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cspace.errors import ScenarioError
from cspace.worlds.spatial.arm import Part, SerialArm
from training.robots.chain import Piece, read_chain
from training.robots.covering import Allowances, Fit, cover, measure
from training.robots.solids import solid_of
from training.robots.srdf import read_disabled_pairs
from training.robots.touching import Touching, touching_pairs
from training.robots.urdf import read_urdf

# What is drawn depends on the description alone.
_SEED = 20261123
# Of written places, m.
_DIGITS = 5


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked for.

    Args:
        urdf: the description.
        srdf: with the pairs that need no check; None for none.
        tip: the link whose frame is the tool's; None where only one is last.
        locked: values of joints that do not move, rad or m.
        limits: of joints, instead of the description's, rad.
        packages: folders of packages that meshes are named in.
        kept: pairs that are held apart whatever the SRDF says.
        allowances: of the spheres.
        ready_rad: where the arm waits, joint after joint; None for the middle of its limits.
    """

    urdf: Path
    srdf: Path | None = None
    tip: str | None = None
    locked: Mapping[str, float] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    packages: Mapping[str, Path] = field(default_factory=dict)
    kept: tuple[tuple[str, str], ...] = ()
    allowances: Allowances = field(default_factory=Allowances)
    ready_rad: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class Imported:
    """A robot, how well its spheres fit by the names of its parts, and the pairs that were looked at."""

    arm: SerialArm
    fits: Mapping[str, Fit]
    touching: tuple[Touching, ...]


def import_robot(request: Request, tell: Callable[[str], None] = lambda _: None) -> Imported:
    """The arm that a request describes.

    Args:
        request: what is asked for.
        tell: takes the name of each part before its spheres are sought.

    Raises:
        ScenarioError: a file is missing or wrong, the robot is no serial arm, or it cannot wait there.
    """
    description = read_urdf(request.urdf)
    disabled = frozenset() if request.srdf is None else read_disabled_pairs(request.srdf)
    chain = read_chain(description, request.tip, request.locked, request.limits)
    names = {piece.name for piece in chain.pieces}
    if unknown := sorted({name for pair in request.kept for name in pair} - names):
        raise ScenarioError("parts are unknown", expected=f"some of {sorted(names)}", got=str(unknown))
    # First, for spheres take a while.
    jointed = SerialArm(description.name, chain.joints, (), (), chain.tool, request.ready_rad)
    parts, fits = [], {}
    for piece in chain.pieces:
        tell(piece.name)
        part, fits[piece.name] = _covered(piece, request)
        parts.append(part)
    bare = replace(jointed, parts=tuple(parts))
    kept = frozenset(frozenset(pair) for pair in request.kept)
    rng = np.random.default_rng(_SEED)
    touching = touching_pairs(bare, chain.neighbours, disabled, kept, rng)
    arm = replace(bare, touching=tuple(one.pair for one in touching if one.kept))
    return Imported(arm, fits, touching)


def robot_text(arm: SerialArm) -> str:
    """The robot as a file: JSON with a list of numbers in one line each."""
    text = json.dumps(arm.to_dict(), indent=1, allow_nan=False)
    return re.sub(r"\[\s*([^\[\]{}]*?)\s*\]", lambda found: f"[{' '.join(found[1].split())}]", text) + "\n"


def _covered(piece: Piece, request: Request) -> tuple[Part, Fit]:
    solid = solid_of(piece, request.urdf.resolve().parent, request.packages)
    rng = np.random.default_rng(_SEED)
    if all(shape.kind == "sphere" for shape in piece.shapes):
        places = np.asarray([shape.frame[:3, 3] for shape in piece.shapes])
        spheres = np.column_stack([places, [shape.size[0] for shape in piece.shapes]])
    else:
        spheres = np.round(cover(solid, request.allowances, rng), _DIGITS)
    rows = tuple((x, y, z, radius) for x, y, z, radius in spheres.tolist())
    return Part(piece.name, piece.link, rows), measure(solid, spheres, rng)
