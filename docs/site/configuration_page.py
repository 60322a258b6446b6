"""The page of configuration: every key that ``--set`` takes, and the presets."""

from collections.abc import Iterator
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml
from markdown_table import code, table
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from training.config import PathTrainConfig, TrainConfig
from training.models.families import families

INTRODUCTION = """\
# Configuration

What fixes a training job. A preset overrides the defaults below, `--set key.sub=value` overrides the preset;
an unknown key or a value that does not fit ends the job before it starts. `--print-config` prints all of it.
The settings of the services are environment variables, and stand in [operations](../operations.md#settings).
"""
BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below", "multiple_of": "a multiple of"}


def markdown() -> str:
    """The page."""
    lines = [INTRODUCTION]
    for config in (TrainConfig, PathTrainConfig):
        command = f"`training/{config.SCRIPT}`"
        lines += [f"## {command}", "", (config.__doc__ or "").strip(), ""]
        lines += [*table(("key", "default", "meaning"), rows(config)), ""]
        for form, kind in families().items() if config is TrainConfig else ():
            shared = {row[0] for row in rows(config)}
            own = [row for row in rows(kind.configuration) if row[0] not in shared]
            lines += [f"### clusters.form={form}", "", (kind.configuration.__doc__ or "").strip(), ""]
            lines += [*table(("key", "default", "meaning"), own), ""]
        lines += [f"### Presets of {command}", ""]
        for path in sorted(config.PRESETS.glob("*.yaml")):
            lines += list(_preset(path))
    return "\n".join(lines)


def rows(
    config: type[BaseModel], before: str = "", given: BaseModel | None = None
) -> Iterator[tuple[str, ...]]:
    """Key, default and meaning of every field, those of sections below it included.

    Args:
        config: the section's type.
        before: the keys above it, with a dot.
        given: its defaults where the section above has some of its own.
    """
    for name, field in config.model_fields.items():
        key = f"{before}{field.alias or name}"
        below = _section(field)
        default = getattr(given, name) if given is not None else _default(field)
        if below is None:
            yield code(key), code(_default_text(default)), _meaning(field)
        else:
            if default is None:
                yield code(key), code(_default_text(None)), _meaning(field)
            yield from rows(below, f"{key}.", default if isinstance(default, below) else None)


def _section(field: FieldInfo) -> type[BaseModel] | None:
    kinds = (field.annotation, *get_args(field.annotation))
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _default(field: FieldInfo) -> Any:
    return None if field.is_required() else field.get_default(call_default_factory=True)


def _default_text(value: Any) -> str:
    """A default as it would be typed; a value of a type of its own by its fields."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, tuple):
        value = list(value)
    return yaml.safe_dump(value, default_flow_style=True, width=1000).removesuffix("...\n").strip()


def _meaning(field: FieldInfo) -> str:
    bounds = [
        f"{words} {getattr(bound, name)}"
        for bound in field.metadata
        for name, words in BOUNDS.items()
        if hasattr(bound, name)
    ]
    choices = [code(str(choice)) for choice in _choices(field.annotation)]
    parts = [field.description, " or ".join(choices), ", ".join(bounds)]
    return "; ".join(part for part in parts if part)


def _choices(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return tuple(choice for part in get_args(annotation) for choice in _choices(part))


def _preset(path: Path) -> Iterator[str]:
    yield from (f"#### {path.stem}", "", "```yaml", path.read_text(encoding="utf-8").rstrip(), "```", "")
