"""What the headers of the sampling endpoint's ``.npy`` answer say, checked against the question."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass

from cspace_client.answer_errors import unusable
from cspace_client.model import ModelHead
from cspace_client.questions.model_head import count, read_media_type, read_model_head, share
from cspace_client.questions.npy_body import NPY
from cspace_client.samples import SourceTiming, Wanted

_MAX_TIMING = 1024


@dataclass(frozen=True, slots=True)
class SampleHead:
    """As :class:`cspace_client.samples.SampleBatch` has it, without the samples.

    Args:
        model: that answered.
        seed: likewise, and so the rest.
        shortfall: likewise.
        timing: likewise.
        acceptance: likewise.
    """

    model: ModelHead
    seed: int
    shortfall: int
    timing: SourceTiming | None
    acceptance: float | None = None


def read_head(headers: Mapping[str, str], query: Wanted, model: str | None) -> SampleHead:
    """The headers of an answer.

    Args:
        headers: of the answer; names in any case if the mapping does not mind it.
        query: which it has to answer.
        model: that was asked for; None for the default.

    Raises:
        SamplerAnswerError: a header is missing, wrong, or answers another question.
    """
    read_media_type(headers, NPY)
    seed = count(headers, "x-seed", 20)
    if seed != query.seed:
        raise unusable("is for another seed", str(query.seed), str(seed))
    shortfall = count(headers, "x-shortfall", 9)
    if shortfall > query.n:
        raise unusable("lacks more samples than were asked for", f"at most {query.n}", str(shortfall))
    return SampleHead(
        model=read_model_head(headers, model, query.robot),
        seed=seed,
        shortfall=shortfall,
        timing=read_timing(headers.get("server-timing", "")),
        acceptance=share(headers, "x-acceptance") if "x-acceptance" in headers else None,
    )


def read_timing(header: str) -> SourceTiming | None:
    """The entries decode, encode, generate and total of a ``Server-Timing`` header; None where one lacks.

    Proxies add entries of their own or drop the header, so nothing in it is an error.
    """
    durations_s: dict[str, float] = {}
    for entry in header.split(",") if len(header) <= _MAX_TIMING else ():
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
