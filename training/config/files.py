"""Presets and overrides as plain values, and their validation."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from cspace.errors import ConfigError
from cspace.yaml_file import read_yaml, read_yaml_file
from training.section import Section

Whole = TypeVar("Whole", bound=Section)


def load_values(folder: Path, preset: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """A preset's values with ``key.sub=value`` overrides, and the preset's name.

    Args:
        folder: of the presets.
        preset: name of a file there without its ending.
        overrides: YAML scalars by dotted key, such as ``global.steps=200``.

    Raises:
        ConfigError: an unknown preset, or an override that is none.
    """
    values = _read(folder, preset)
    values["preset"] = preset
    for override in overrides:
        _set(values, override)
    return values


def validated(kind: type[Whole], values: dict[str, Any], command: str) -> Whole:
    """The configuration of plain values.

    Args:
        kind: of configuration.
        values: by key.
        command: where its keys can be looked up, for the message.

    Raises:
        ConfigError: an unknown key, or a value of the wrong type or range.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or repr(values.get("preset"))
        raise ConfigError(
            f"the configuration key {where} does not fit",
            expected=first["msg"].removeprefix("Value error, "),
            got=repr(first["input"]),
            remedy=f"{command} --help lists presets, --print-config the keys",
        ) from error


def named_presets(folder: Path) -> list[str]:
    """Names of the presets in a folder."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def _read(folder: Path, preset: str) -> dict[str, Any]:
    """A preset's values, on top of those of the preset that it names as its ``base``."""
    path = folder / f"{preset}.yaml"
    if not path.is_file() or path.parent != folder:
        raise ConfigError(
            "the preset is unknown", expected=", ".join(named_presets(folder)), got=repr(preset)
        )
    values: dict[str, Any] = read_yaml_file(path, ConfigError).values or {}
    base = values.pop("base", None)
    return values if base is None else _merged(_read(folder, base), values)


def _merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    both = {key: _merged(base[key], changes[key]) for key in base if isinstance(changes.get(key), dict)}
    return base | changes | both


def _set(values: dict[str, Any], override: str) -> None:
    key, separator, text = override.partition("=")
    if not separator or not key:
        raise ConfigError("an override does not fit", expected="key.sub=value", got=repr(override))
    *parents, last = key.split(".")
    for parent in parents:
        values = values.setdefault(parent, {})
        if not isinstance(values, dict):
            raise ConfigError(
                f"{key!r} is no section", expected="a section's name before the dot", got=parent
            )
    values[last] = read_yaml(text, f"the value of {key!r}", ConfigError).values
