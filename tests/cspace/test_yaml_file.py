"""YAML that others wrote: what is read, and the line of what is refused."""

import json
from pathlib import Path

import pytest

from cspace.errors import ConfigError
from cspace.yaml_file import MAX_BYTES, MAX_DEPTH, MAX_VALUES, read_yaml, read_yaml_file

PLAIN = """\
# what JSON has
name: "2026-11-25"
counts: [1, -2, 0x1f]
sizes: {a: 1.5, b: 1e-3, c: -2E+4, d: 1.0e+5}
whether: [true, null, ~]
"""
LEVELS = ["a0: &a0 [1, 1]", *(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 9))]
DEPTHS = ["- &a0 [1]", *(f"- &a{n} [*a{n - 1}]" for n in range(1, 99))]
REFUSED = {
    "aliases of aliases": ("\n".join(LEVELS), 6, "too many values"),
    "aliases that nest": ("\n".join(DEPTHS), MAX_DEPTH, "nested too deep"),
    "a part that holds itself": ("a: &a\n  b: *a\n", 2, "holds itself"),
    "an alias of nothing": ("a: 1\nb: *a\n", 2, "no YAML"),
    "many values": ("[" + "1," * MAX_VALUES, 1, "too many values"),
    "much depth": ("a:\n  " + "[" * MAX_DEPTH, 2, "nested too deep"),
    "much depth in JSON": ('{"a":' * 100_000, 1, "nested too deep"),
    "infinity": ("a:\n- .inf\n", 2, "number"),
    "infinity by its exponent": ("a: 1e999\n", 1, "number"),
    "no number": ("a: .nan\n", 1, "number"),
    "a huge number": (f"a: 0x{'f' * 17}\n", 1, "number"),
    "a number of many digits": ("a: " + "9" * 5000, 1, "number"),
    "a number without digits": ("a: 0x_\n", 1, "number"),
    "a key twice": ("a: 1\nb:\n  c: 1\n  c: 2\n", 4, "the key c stands twice"),
    "a number as a key": ("a: 1\n2: 1\n", 2, "a key is no text"),
    "a list as a key": ("? [1]\n: 1\n", 1, "a key is no text"),
    "a date": ("a: 2026-11-25\n", 1, "timestamp"),
    "a tag": ("a: !!python/object:os.system {}\n", 1, "python/object"),
    "a binary": ("a: !!binary aGk=\n", 1, "binary"),
}


def test_values_of_json_are_read() -> None:
    assert read_yaml(PLAIN, "it", ConfigError).values == {
        "name": "2026-11-25",
        "counts": [1, -2, 31],
        "sizes": {"a": 1.5, "b": 1e-3, "c": -2e4, "d": 1e5},
        "whether": [True, None, None],
    }


def test_json_is_read_as_json_reads_it() -> None:
    values = {"a": [1e-7, 1e22, 2**64 - 1, -0.0, 5], "b": {"ä\n": 'x"'}, "c": "1e-3", "d": [[], {}]}
    assert read_yaml(json.dumps(values).encode(), "it", ConfigError).values == values


def test_aliases_stand_for_what_they_name() -> None:
    text = "a: &a {x: 1, y: 2}\nb: [*a, *a]\nc:\n  <<: *a\n  x: 3\n"
    values = {"x": 1, "y": 2}
    assert read_yaml(text, "it", ConfigError).values == {
        "a": values,
        "b": [values] * 2,
        "c": {"x": 3, "y": 2},
    }


@pytest.mark.parametrize("name", REFUSED)
def test_anything_else_is_refused_with_its_line(name: str) -> None:
    text, line, words = REFUSED[name]
    with pytest.raises(ConfigError, match=f"^it:{line}\\b.*{words}"):
        read_yaml(text, "it", ConfigError)


@pytest.mark.parametrize(
    "text", [b"\xff", b"a: \x00", b"a: [1", b"a: 1\n---\nb: 2\n", b"#" * (MAX_BYTES + 1)]
)
def test_what_is_no_document_is_refused(text: bytes | str) -> None:
    with pytest.raises(ConfigError, match=r"^it"):
        read_yaml(text, "it", ConfigError)


def test_an_empty_text_holds_nothing() -> None:
    document = read_yaml("# nothing\n", "it", ConfigError)
    assert (document.values, document.line(("a",))) == (None, 1)


def test_places_have_lines() -> None:
    document = read_yaml("a:\n  - x: 1\n  -\n    y: 2\n", "it", ConfigError)
    places = ((), ("a",), ("a", 1, "y"), ("a", 1, "z"), ("a", 7), ("b",))
    assert [document.line(place) for place in places] == [1, 1, 4, 4, 1, 1]


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml cannot be read"):
        read_yaml_file(tmp_path / "absent.yaml", ConfigError)
