"""Names of models as users write them: ``name``, ``name@alias``, ``name/version``, ``pretrained``."""

import re
from dataclasses import dataclass

from cspace.errors import ConfigError, InputError
from services.names import ALIAS_CHAMPION
from services.registry.models.port import ModelReader, ModelVersion

PRETRAINED = "pretrained"
# Of other robots than the default one, and the folders of all beside the API's code.
SHIPPED = {PRETRAINED: "pretrained", f"{PRETRAINED}-panda": "pretrained_panda"}

# Names become folders of the cache: no separators, no leading dot.
_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_PATTERN = re.compile(
    rf"(?P<name>{_NAME})"
    r"(?:@(?P<alias>[A-Za-z0-9_-]{1,100})|/(?P<version>[1-9][0-9]{0,8}))?",
    re.ASCII,
)


def is_shipped(name: str) -> bool:
    """Whether a name is one of those that the server's own models have."""
    return name in SHIPPED


def is_model_name(text: str) -> bool:
    """Whether a text can be a model's name, and so a folder's of the cache."""
    return re.fullmatch(_NAME, text, re.ASCII) is not None


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A parsed reference.

    Args:
        name: of the registered model, or ``pretrained``.
        alias: None when none was given.
        version: None when none was given.
    """

    name: str
    alias: str | None = None
    version: int | None = None

    @classmethod
    def parse(cls, text: str) -> "ModelReference":
        """Read a reference.

        Raises:
            InputError: it follows none of the forms.
        """
        found = cls._read(text)
        if found is None:
            raise InputError(
                "model is not a reference",
                expected="name, name@alias, name/version or pretrained",
                got=repr(text)[:200],
            )
        return found

    @classmethod
    def parse_version(
        cls, text: str, what: str, expected: str = "name@alias or name/version"
    ) -> "ModelReference":
        """Read a reference that names an alias or a version.

        Args:
            text: to read.
            what: is wrong where it does not, for the message.
            expected: likewise.

        Raises:
            ConfigError: it does not.
        """
        found = cls._read(text)
        if found is None or found.is_bare:
            raise ConfigError(what, expected=expected, got=repr(text))
        return found

    @classmethod
    def _read(cls, text: str) -> "ModelReference | None":
        match = _PATTERN.fullmatch(text)
        if match is None:
            return None
        version = match["version"]
        return cls(match["name"], match["alias"], None if version is None else int(version))

    def look_up(self, registry: ModelReader) -> ModelVersion:
        """The version that is meant.

        Raises:
            ModelNotFoundError: there is none.
            RegistryError: the registry does not answer.
        """
        if self.version is not None:
            return registry.version(self.name, self.version)
        return registry.by_alias(self.name, self.alias or ALIAS_CHAMPION)

    @property
    def is_bare(self) -> bool:
        """Whether neither alias nor version was given; the champion is meant."""
        return self.alias is None and self.version is None

    def __str__(self) -> str:
        if self.version is not None:
            return f"{self.name}/{self.version}"
        return self.name if self.alias is None else f"{self.name}@{self.alias}"
