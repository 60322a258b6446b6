"""What every part of a configuration is."""

from typing import Any

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A frozen part of a configuration that refuses unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, with the keys that ``--set`` takes."""
        return self.model_dump(mode="json", by_alias=True)
