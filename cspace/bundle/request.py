"""The arguments of a sampling request, checked against the bundle that is to answer it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

from cspace.bundle.spec import BundleSpec
from cspace.errors import InputError
from cspace.space import to_float32

MAX_SEED = 2**64 - 1
MAX_EPSILON = 10.0


@dataclass(frozen=True, slots=True)
class Request:
    """A request that fits its bundle.

    Args:
        count: samples asked for.
        seed: unsigned 64 bit.
        epsilon_sigma: the schedule.
        start: (d,) rad wrapped, None for models that take none.
        goal: as ``start``.
        min_confidence: 0 to 1; 0 keeps everything.
    """

    count: int
    seed: int
    epsilon_sigma: tuple[float, ...]
    start: tuple[float, ...] | None
    goal: tuple[float, ...] | None
    min_confidence: float

    @classmethod
    def checked(
        cls,
        spec: BundleSpec,
        count: int,
        seed: int,
        epsilon_sigma: Sequence[float],
        start: ArrayLike | None,
        goal: ArrayLike | None,
        min_confidence: float | None,
        *,
        has_validity: bool,
    ) -> "Request":
        """Validate every argument; without ``min_confidence`` the bundle's own threshold holds.

        Raises:
            InputError: one is out of range or does not fit the bundle.
        """
        if min_confidence is None:
            min_confidence = (spec.confidence_threshold or 0.0) if has_validity else 0.0
        _whole("n", count, 1, None)
        _whole("seed", seed, 0, MAX_SEED)
        if not epsilon_sigma:
            raise InputError("epsilon_sigma is empty", expected="one value or more", got="none")
        for value in epsilon_sigma:
            _within("epsilon_sigma", value, MAX_EPSILON)
        _within("min_confidence", min_confidence, 1.0)
        if min_confidence > 0.0 and not has_validity:
            raise InputError(
                "the model has no validity head",
                expected="min_confidence 0",
                got=str(min_confidence),
                remedy="leave min_confidence out, or choose a model with a validity head",
            )
        return cls(
            int(count),
            int(seed),
            tuple(float(value) for value in epsilon_sigma),
            _endpoint(spec, "start", start),
            _endpoint(spec, "goal", goal),
            float(min_confidence),
        )


def _endpoint(spec: BundleSpec, name: str, value: ArrayLike | None) -> tuple[float, ...] | None:
    if name not in spec.endpoints:
        if value is None:
            return None
        raise InputError(
            f"the model takes no {name}",
            expected=f"no {name} for a {spec.kind} model",
            got=str(value)[:200],
            remedy=f"leave {name} out, or choose a path model",
        )
    if value is None:
        raise InputError(
            f"the model needs a {name}",
            expected=f"{spec.dim} angles in rad",
            got="none",
            remedy=f"send {name}",
        )
    try:
        angles = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        angles = np.empty(0)
    if angles.shape != (spec.dim,) or not np.all(np.isfinite(angles)):
        raise InputError(
            f"{name} does not fit the robot",
            expected=f"{spec.dim} finite angles in rad",
            got=str(value)[:200],
        )
    return tuple(to_float32(angles).tolist())


def _whole(name: str, value: object, low: int, high: int | None) -> None:
    fits = isinstance(value, Integral) and not isinstance(value, bool)
    if not fits or value < low or (high is not None and value > high):  # type: ignore[operator]
        expected = f"a whole number, at least {low}" + ("" if high is None else f" and at most {high}")
        raise InputError(f"{name} is out of range", expected=expected, got=repr(value)[:200])


def _within(name: str, value: object, high: float) -> None:
    fits = isinstance(value, Real) and not isinstance(value, bool | np.bool_)
    if not fits or not math.isfinite(value) or not 0.0 <= value <= high:  # type: ignore[arg-type, operator]
        raise InputError(
            f"{name} is out of range", expected=f"a finite number from 0 to {high:g}", got=repr(value)[:200]
        )
