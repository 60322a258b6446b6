"""Reading the sampling endpoint's ``.npy`` answer: bytes and headers from outside, checked before use."""

import io
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple

import numpy as np
from numpy.typing import NDArray

from cspace.errors import SamplerError
from services.planner.samples import SampleBatch, SourceTiming

NPY = "application/x-npy"


def read_batch(body: bytes, headers: Mapping[str, str], n: int, round_trip_s: float) -> SampleBatch:
    """The batch that an answer holds.

    Args:
        body: a float32 ``.npy`` of shape (n - shortfall, d).
        headers: of the answer; names in any case if the mapping does not mind it.
        n: how many samples were asked for.
        round_trip_s: how long the answer took.

    Raises:
        SamplerError: a header or the array is missing or wrong.
    """
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != NPY:
        raise _unusable("has another media type", NPY, repr(media_type))
    shortfall = _count(headers, "x-shortfall")
    samples = _read_array(body)
    if len(samples) != n - shortfall:
        raise _unusable("has another number of samples", f"{n} - {shortfall}", str(len(samples)))
    return SampleBatch(
        samples=samples,
        model_name=_text(headers, "x-model-name"),
        model_version=_count(headers, "x-model-version"),
        digest=_text(headers, "x-model-digest"),
        seed=_count(headers, "x-seed"),
        shortfall=shortfall,
        round_trip_s=round_trip_s,
        novelty=_share(headers, "x-novelty") if "x-novelty" in headers else None,
        timing=read_timing(headers.get("server-timing", "")),
    )


def read_timing(header: str) -> SourceTiming | None:
    """The entries decode, encode, generate and total of a ``Server-Timing`` header; None where one lacks.

    Proxies add entries of their own or drop the header, so nothing in it is an error.
    """
    durations_s: dict[str, float] = {}
    for entry in header.split(","):
        name, *parameters = (part.strip() for part in entry.split(";"))
        duration = next((one.removeprefix("dur=") for one in parameters if one.startswith("dur=")), "")
        with suppress(ValueError):
            durations_s[name] = 1e-3 * float(duration)
    try:
        found = SourceTiming(*(durations_s[name] for name in ("decode", "encode", "generate", "total")))
    except KeyError:
        return None
    whole = all(math.isfinite(value) and value >= 0.0 for value in astuple(found))
    return found if whole else None


def _read_array(body: bytes) -> NDArray[np.float32]:
    buffer = io.BytesIO(body)
    try:
        version = np.lib.format.read_magic(buffer)
        if version != (1, 0):
            raise _unusable("has another .npy version", "1.0", ".".join(map(str, version)))
        shape, by_columns, dtype = np.lib.format.read_array_header_1_0(buffer)
    except ValueError as error:
        raise _unusable("is no .npy file", "a .npy file", str(error)) from error
    content = memoryview(body)[buffer.tell() :]
    # Shape against size first: a header may claim any shape, and an array of it would be allocated.
    fits = len(shape) == 2 and min(shape) >= 0 and 4 * shape[0] * shape[1] == len(content)
    if dtype != np.dtype("<f4") or by_columns or not fits:
        raise _unusable(
            "holds another array",
            "float32 of shape (n, d), by rows",
            f"{dtype} of shape {shape} in {len(content)} bytes",
        )
    samples = np.frombuffer(content, dtype="<f4").reshape(shape).astype(np.float32, copy=False)
    # As real numbers: float32(pi) lies above pi.
    angles = samples.astype(np.float64)
    if not np.all((angles >= -np.pi) & (angles < np.pi)):
        wrong = int(np.sum(~((angles >= -np.pi) & (angles < np.pi))))
        raise _unusable("holds values that are no wrapped angles", "[-pi, pi)", f"{wrong} others")
    return samples


def _text(headers: Mapping[str, str], name: str) -> str:
    value = headers.get(name, "")
    if not value:
        raise _unusable("lacks a header", name, "nothing")
    return value


def _count(headers: Mapping[str, str], name: str) -> int:
    value = _text(headers, name)
    if not (value.isascii() and value.isdigit() and len(value) <= 20):
        raise _unusable(f"has a wrong header {name}", "a whole number", repr(value[:40]))
    return int(value)


def _share(headers: Mapping[str, str], name: str) -> float:
    value = _text(headers, name)
    try:
        share = float(value)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 1.0:
        raise _unusable(f"has a wrong header {name}", "a number from 0 to 1", repr(value[:40]))
    return share


def _unusable(what: str, expected: str, got: str) -> SamplerError:
    return SamplerError(
        f"the sampling endpoint's answer {what}",
        expected=expected,
        got=got,
        remedy="check that the address is an inference API of this release",
    )
