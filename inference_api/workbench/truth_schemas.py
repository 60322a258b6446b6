"""What the workbench asks of the truth and is told, as types."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, Field, Strict

from cspace.query import MAX_SEED
from inference_api.pages.schemas import RequestFields

# A picture of joint 1 against joint 2 that is finer than anybody sees.
MAX_CELLS = 160
MAX_DISCS = 64
# What is on the page at once; the nearest sample of each reference is looked for among them.
MAX_SHOWN = 2_000

Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Row = Annotated[tuple[Number, ...], Field(min_length=1, max_length=64), Strict(strict=False)]
_Radius = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
_Disc = Annotated[tuple[Number, Number, _Radius], Strict(strict=False)]
Discs = Annotated[tuple[_Disc, ...], Field(max_length=MAX_DISCS), Strict(strict=False)]
Rows = Annotated[tuple[Row, ...], Field(max_length=MAX_SHOWN), Strict(strict=False)]

DISCS_EXPECTED = f"at most {MAX_DISCS} of x, y and radius in m, the radius above 0"
MODEL_EXPECTED = "name, name@alias, name/version or pretrained"


class SceneRequest(RequestFields):
    """Which scene of a family is wanted."""

    EXPECTED: ClassVar[Mapping[str, str]] = {
        "model": MODEL_EXPECTED,
        "family": "a family of the model's robot, or nothing for the first",
        "seed": f"a whole number from 0 to {MAX_SEED}",
    }
    model: str = ""
    family: Annotated[str, Field(max_length=100)] | None = None
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] = 0


class TruthRequest(RequestFields):
    """A scene of discs, and what is held against it."""

    EXPECTED: ClassVar[Mapping[str, str]] = {
        "model": MODEL_EXPECTED,
        "discs": DISCS_EXPECTED,
        "cells": f"a whole number from 8 to {MAX_CELLS}",
        "at": "an angle in rad for each joint",
        "configurations": f"at most {MAX_SHOWN} arrays of angles in rad",
        "path": f"at most {MAX_SHOWN} arrays of angles in rad",
    }
    model: str = ""
    discs: Discs
    cells: Annotated[int, Field(ge=8, le=MAX_CELLS)] = 96
    at: Row | None = None
    configurations: Rows = ()
    path: Rows = ()


class SceneAnswer(BaseModel):
    """A problem of a family.

    Args:
        discs: x, y, radius in m.
        start: rad.
        goal: rad.
        family: whose it is.
        families: of the robot, the first one first.
        seed: it was drawn from.
    """

    discs: list[list[float]]
    start: list[float]
    goal: list[float]
    family: str
    families: list[str]
    seed: int


class WayTruth(BaseModel):
    """Whether a way is free.

    Args:
        free: all of it.
        edges: each piece of it.
        clearance_m: the least distance to what the robot collides with, at the way's points.
    """

    free: bool
    edges: list[bool]
    clearance_m: float


class TruthAnswer(BaseModel):
    """What holds in truth.

    Args:
        cells: how many there are along each of the first two joints.
        free: base64 of one bit a cell, most significant first, joint 1 the slower axis; the other joints
            stand where ``at`` has them.
        sample_free: for each configuration.
        precision: share of the configurations that are free; None without any.
        coverage: share of free configurations, drawn evenly, with one of the free samples within
            ``radius_rad``.
        radius_rad: of coverage.
        way: of the path; None without one.
        families: that scenes can be asked of.
        timing_ms: of all of it.
    """

    cells: int
    free: str
    sample_free: list[bool]
    precision: float | None
    coverage: float | None
    radius_rad: float
    way: WayTruth | None
    families: list[str]
    timing_ms: dict[str, Any]
