"""Calibrations of plans for a site: versions of the model ``calibration-SITE`` that consist of tags."""

from typing import Annotated, Any

from pydantic import Field

from cspace.errors import RegistryError
from cspace.strict_json import Record, validated
from services.names import CALIBRATION_PREFIX
from services.registry.ports import ModelVersion

_Number = Annotated[float, Field(ge=-10.0, le=10.0)]


def calibration_name(site: str) -> str:
    """The registered model of a site's calibrations."""
    return f"{CALIBRATION_PREFIX}{site}"


@validated(RegistryError)
class SiteCalibration(Record):
    """How the cost of plans at a site becomes confidence: log D' = offset + slope log D.

    D is -log of what the model itself is confident of, D' of what the site's outcomes say.

    Args:
        model: whose plans it was fitted to, as ``name/version``.
        offset: 0 leaves the confidence as it is.
        slope: above 0; 1 leaves it as it is.

    Raises:
        RegistryError: a value is none that a calibration has.
    """

    model: str
    offset: _Number
    slope: Annotated[_Number, Field(gt=0.0)]

    @classmethod
    def of(cls, version: ModelVersion) -> "SiteCalibration":
        """As a version's tags hold it; raises RegistryError where they do not."""
        # pydantic reads numbers from their texts.
        values: dict[str, Any] = {name: version.tags.get(name, "") for name in ("model", "offset", "slope")}
        return cls(**values)

    def after(self, calibration: tuple[float, float]) -> tuple[float, float]:
        """(a, b) of this calibration upon a bundle's."""
        a, b = calibration
        return self.offset + self.slope * a, self.slope * b

    @property
    def tags(self) -> dict[str, str]:
        """For the version."""
        return {"model": self.model, "offset": repr(self.offset), "slope": repr(self.slope)}
