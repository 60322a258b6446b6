"""What the headers of the sampling endpoint's ``.npy`` answer say, checked against the question."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import astuple, dataclass
from typing import Any

from cspace.errors import InputError
from cspace.query import is_digest
from cspace.space import MAX_LIMIT_RAD, JointSpace, circles
from cspace.strict_json import parse_json, read_mapping, read_object
from services.planner.sources.answer_errors import unusable
from services.planner.sources.http_exchange import Question
from services.planner.sources.npy_body import MAX_JOINTS, NPY
from services.planner.sources.samples import SourceTiming

_PRETRAINED = "pretrained"
_MAX_TEXT = 256
_MAX_TIMING = 1024


@dataclass(frozen=True, slots=True)
class AnswerHead:
    """As :class:`services.planner.sources.samples.SampleBatch` has it, without the samples."""

    model_name: str
    model_version: int
    digest: str
    seed: int
    shortfall: int
    novelty: float | None
    timing: SourceTiming | None
    space: JointSpace | None = None
    robot: str | None = None
    alias_confirmed: bool | None = None
    acceptance: float | None = None


def read_head(headers: Mapping[str, str], question: Question) -> AnswerHead:
    """The headers of an answer.

    Args:
        headers: of the answer; names in any case if the mapping does not mind it.
        question: which it has to answer.

    Raises:
        SamplerAnswerError: a header is missing, wrong, or answers another question.
    """
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != NPY:
        raise unusable("has another media type", NPY, repr(media_type))
    query, seed = question.query, _count(headers, "x-seed", 20)
    if seed != query.seed:
        raise unusable("is for another seed", str(query.seed), str(seed))
    shortfall = _count(headers, "x-shortfall", 9)
    if shortfall > query.n:
        raise unusable("lacks more samples than were asked for", f"at most {query.n}", str(shortfall))
    name, version = _text(headers, "x-model-name"), _count(headers, "x-model-version", 9)
    if not _answers(question.model, name, version):
        raise unusable("comes from another model", str(question.model), f"{name}/{version}")
    robot = _digest(headers, "x-robot") if "x-robot" in headers else None
    if robot is not None and query.robot not in (None, robot):
        raise unusable("is of another robot", str(query.robot), robot)
    return AnswerHead(
        model_name=name,
        model_version=version,
        digest=_digest(headers, "x-model-digest"),
        seed=seed,
        shortfall=shortfall,
        novelty=_share(headers, "x-novelty") if "x-novelty" in headers else None,
        timing=read_timing(headers.get("server-timing", "")),
        space=read_space(headers["x-joint-space"]) if "x-joint-space" in headers else None,
        robot=robot,
        alias_confirmed=_flag(headers, "x-alias-confirmed") if "x-alias-confirmed" in headers else None,
        acceptance=_share(headers, "x-acceptance") if "x-acceptance" in headers else None,
    )


def read_space(header: str) -> JointSpace:
    """The joint space that an answer says its samples are of.

    Raises:
        SamplerAnswerError: it says none.
    """
    try:
        said = read_mapping(parse_json(header.encode()), "the joint space", InputError)
        space = _space_of(said)
    except ValueError:
        space = None
    if space is None or space.to_dict() != said:
        raise unusable("has a wrong header x-joint-space", "the joint space as JSON", repr(header[:80]))
    return space


def _space_of(said: dict[str, Any]) -> JointSpace | None:
    dim = said.get("dim")
    if not isinstance(dim, int) or not 1 <= dim <= MAX_JOINTS:
        return None
    if said.get("kind") == "torus":
        return circles(dim)
    limits = {name: value for name, value in said.items() if name not in ("kind", "dim", "unit")}
    space = read_object(JointSpace, limits, "the joint space", InputError)
    joints = zip(space.lower, space.upper, space.periodic, strict=True)
    fits = all(-MAX_LIMIT_RAD <= low < high <= MAX_LIMIT_RAD for low, high, _ in joints)
    return space if fits else None


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


def _answers(asked: str | None, name: str, version: int) -> bool:
    """Whether a model is the one that a reference names.

    A shipped model stands in for a model of its robot without a champion. Which model is the default only
    the server knows, so it may do that for every bare name; an alias or a version has no stand-in.
    """
    if asked is None:
        return True
    asked_name, slash, asked_version = asked.partition("/")
    if slash:
        return (name, str(version)) == (asked_name, asked_version)
    bare, at, _ = asked.partition("@")
    shipped = version == 0 and name.partition("-")[0] == _PRETRAINED
    return name == bare or (not at and shipped)


def _text(headers: Mapping[str, str], name: str) -> str:
    value = headers.get(name, "")
    if not value:
        raise unusable("lacks a header", name, "nothing")
    if len(value) > _MAX_TEXT or not (value.isascii() and value.isprintable()):
        expected = f"at most {_MAX_TEXT} printable ASCII characters"
        raise unusable(f"has a wrong header {name}", expected, repr(value[:40]))
    return value


def _count(headers: Mapping[str, str], name: str, digits: int) -> int:
    value = _text(headers, name)
    if not (value.isdigit() and len(value) <= digits):
        raise unusable(f"has a wrong header {name}", "a whole number", repr(value[:40]))
    return int(value)


def _digest(headers: Mapping[str, str], name: str) -> str:
    value = _text(headers, name)
    if not is_digest(value):
        raise unusable(f"has a wrong header {name}", "a SHA-256 in hexadecimal", repr(value[:80]))
    return value


def _flag(headers: Mapping[str, str], name: str) -> bool:
    value = _text(headers, name)
    if value not in ("true", "false"):
        raise unusable(f"has a wrong header {name}", "true or false", repr(value[:40]))
    return value == "true"


def _share(headers: Mapping[str, str], name: str) -> float:
    value = _text(headers, name)
    try:
        share = float(value)
    except ValueError:
        share = math.nan
    if not 0.0 <= share <= 1.0:
        raise unusable(f"has a wrong header {name}", "a number from 0 to 1", repr(value[:40]))
    return share
