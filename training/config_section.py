"""What every part of a configuration is."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python


def _absolute(path: Path) -> Path:
    if not path.is_absolute():
        raise ValueError("the path has to be absolute, for jobs run in another folder than you submit from")
    return path


# On storage that all nodes share.
AbsolutePath = Annotated[Path, AfterValidator(_absolute)]

# Absent from what is recorded where it is not given.
RobotName = Annotated[
    str | None,
    Field(
        exclude_if=lambda name: name is None,
        description="letters, digits and -: models of a robot that is no example are named after it; none to "
        "derive a name from the robot's digest",
    ),
]


class Section(BaseModel):
    """A frozen part of a configuration that refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with the keys that ``--set`` takes."""
        return self.model_dump(mode="json", by_alias=True)


def described(section: BaseModel, prefix: str = "") -> Iterator[str]:
    """A line for each key that ``--set`` takes, with its value and what it is."""
    for name, field in type(section).model_fields.items():
        key, part = prefix + (field.alias or name), getattr(section, name)
        if isinstance(part, BaseModel):
            yield from described(part, f"{key}.")
        else:
            text = f"{key}={json.dumps(to_jsonable_python(part))}"
            yield f"{text:<40}  # {field.description}" if field.description else text
