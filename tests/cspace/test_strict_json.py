"""One reader of strict JSON for bundles, data sets, worlds and headers."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import pytest
from pydantic import PlainValidator

from cspace.errors import DatasetError, ScenarioError
from cspace.strict_json import LEFT_OUT, MAX_DEPTH, Span, parse_json, read_object, validated, written


def doubled(value: object) -> int:
    if not isinstance(value, int):
        raise ScenarioError("no number to double")
    return 2 * value


@validated(DatasetError)
class Inner:
    low: float
    high: float | None = None


@validated(DatasetError)
class Outer:
    name: str
    count: int
    sure: bool | None
    rows: tuple[tuple[float, ...], ...]
    pair: tuple[float, int] | None
    parts: tuple[Inner, ...]
    inner: Inner | None
    sums: Mapping[str, int]
    anything: Any
    twice: Annotated[int, PlainValidator(doubled)]
    note: Annotated[str | None, LEFT_OUT] = None


@validated(DatasetError)
class Ends:
    span: Span[int]


GOOD: dict[str, Any] = {
    "name": "a", "count": 3, "sure": None, "rows": [[1, 2.5], []], "pair": [0.5, 2],
    "parts": [{"low": 1, "high": None}], "inner": {"low": 0.5, "high": 2},
    "sums": {"x": 1}, "anything": [{"y": None}], "twice": 4,
}  # fmt: skip


def test_an_object_is_read_by_the_types_of_its_fields_and_written_as_it_was() -> None:
    found = read_object(Outer, GOOD, "it", DatasetError)
    assert found == Outer(
        "a", 3, None, ((1.0, 2.5), ()), (0.5, 2), (Inner(1.0, None),), Inner(0.5, 2.0), {"x": 1},
        [{"y": None}], 4,
    )  # fmt: skip
    assert type(found.rows[0][0]) is float
    assert written(found) == GOOD | {"twice": 8}
    assert json.loads(json.dumps(written(found))) == written(found)


@pytest.mark.parametrize(
    "change",
    [
        {"name": None}, {"name": 1}, {"count": 3.0}, {"count": True}, {"count": "3"}, {"count": None},
        {"sure": 1}, {"rows": {}}, {"rows": [1.0]}, {"rows": [[True]]}, {"rows": [["1"]]},
        {"rows": [[math.nan]]}, {"rows": [[math.inf]]}, {"rows": None}, {"pair": [0.5]},
        {"pair": [0.5, 2, 3]}, {"pair": [2, 0.5]}, {"parts": [None]}, {"parts": [{"low": 1}]},
        {"inner": {"low": None, "high": 1}}, {"inner": []}, {"inner": {"low": 1, "high": 2, "more": 3}},
        {"sums": [1]}, {"sums": {"x": 1.5}},
    ],
    ids=str,
)  # fmt: skip
def test_what_is_of_another_type_is_refused_with_its_place(change: dict[str, Any]) -> None:
    with pytest.raises(DatasetError, match=f"^it: {next(iter(change))}.*expected.*got"):
        read_object(Outer, GOOD | change, "it", DatasetError)


def test_every_field_has_to_be_there_and_no_other() -> None:
    with pytest.raises(DatasetError, match="it: more is unknown"):
        read_object(Outer, GOOD | {"more": 1}, "it", DatasetError)
    for name in GOOD:
        with pytest.raises(DatasetError, match=f"it: {name} is missing"):
            read_object(Outer, {key: GOOD[key] for key in GOOD if key != name}, "it", DatasetError)
    with pytest.raises(DatasetError, match=r"it: parts\.1\.high is missing"):
        read_object(Outer, GOOD | {"parts": [GOOD["inner"], {"low": 1}]}, "it", DatasetError)
    for values in (None, [], "text", 5):
        with pytest.raises(DatasetError, match="it does not fit; expected an object"):
            read_object(Outer, values, "it", DatasetError)


def test_a_reader_of_its_own_judges_by_itself() -> None:
    with pytest.raises(DatasetError, match="it: no number"):
        read_object(Outer, GOOD | {"twice": "4"}, "it", DatasetError)


def test_a_constructor_takes_lists_and_whole_numbers_and_raises_the_projects_error() -> None:
    found = read_object(Outer, GOOD, "it", DatasetError)
    made = replace(found, rows=[[1, 2.5], []], twice=4)  # type: ignore[arg-type] # a list
    assert made == found
    assert type(made.rows[0][0]) is float
    with pytest.raises(DatasetError, match="the inner: low does not fit; expected a finite number"):
        Inner(math.nan)
    with pytest.raises(DatasetError, match="the ends: span does not fit; expected a range from low to high"):
        Ends((2, 1))


def test_a_message_is_short_whatever_came() -> None:
    with pytest.raises(DatasetError) as refused:
        read_object(Outer, GOOD | {"name": ["x" * 10**6]}, "it", DatasetError)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize(
    "data",
    [
        b"", b"{", b"\xff\xfe", b"[NaN]", b"[-Infinity]", b"[1e999]", b'{"a": 1, "a": 2}',
        b'[{"a": 1, "a": 1}]', b"[" * 100_000, b"18446744073709551616", b"-18446744073709551616",
        b"9" * 10_000,
    ],
    ids=lambda data: repr(data[:20]),
)  # fmt: skip
def test_a_text_that_is_no_strict_json_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"^.{5,300}$"):
        parse_json(data)


def test_numbers_are_kept_to_the_last_bit() -> None:
    data = b'[18446744073709551615, -18446744073709551615, 0.1, -0.0, {"\xc3\xa9": 5e-324}]'
    found = parse_json(data)
    assert found == [2**64 - 1, 1 - 2**64, 0.1, 0.0, {"é": 5e-324}]


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ('{"a":', "}")])
@pytest.mark.parametrize("levels", [MAX_DEPTH + 1, 900, 100_000])
def test_texts_that_are_nested_deep_are_refused_and_flat_ones_of_many_parts_are_not(
    opening: str, closing: str, levels: int
) -> None:
    def nested(count: int) -> bytes:
        return (opening * count + "1" + closing * count).encode()

    with pytest.raises(ValueError, match=r"nested|recursion"):
        parse_json(nested(levels))
    assert parse_json(nested(MAX_DEPTH))
    assert parse_json(b"[" + b",".join([nested(2)] * MAX_DEPTH) + b"]")
