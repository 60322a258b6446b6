"""Names of models as requests write them: ``name``, ``name@alias``, ``name/version``, ``pretrained``."""

import re
from dataclasses import dataclass

from cspace.errors import ConfigError, InputError

CHAMPION = "champion"
PRETRAINED = "pretrained"

# Names become folders of the cache: no separators, no leading dot.
_NAME = r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}"
_PATTERN = re.compile(
    rf"(?P<name>{_NAME})"
    r"(?:@(?P<alias>[A-Za-z0-9_-]{1,100})|/(?P<version>[1-9][0-9]{0,8}))?",
    re.ASCII,
)


def is_model_name(text: str) -> bool:
    """Whether a text can be a model's name, and so a folder's of the cache."""
    return re.fullmatch(_NAME, text, re.ASCII) is not None


def served_name(text: str) -> str:
    """The name of the model whose champion is the default, as ``CSPACE_MODEL_NAME`` sets it.

    Raises:
        ConfigError: no request could name it.
    """
    if not is_model_name(text) or text == PRETRAINED:
        raise ConfigError(
            "the setting CSPACE_MODEL_NAME is wrong",
            expected=f"1 to 100 letters, digits, '.', '_' and '-', first a letter or digit; not {PRETRAINED}",
            got=repr(text)[:200],
            remedy="name a registered model, or unset it",
        )
    return text


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
        match = _PATTERN.fullmatch(text)
        if match is None:
            raise InputError(
                "model is not a reference",
                expected="name, name@alias, name/version or pretrained",
                got=repr(text)[:200],
            )
        version = match["version"]
        return cls(match["name"], match["alias"], None if version is None else int(version))

    @property
    def is_bare(self) -> bool:
        """Whether neither alias nor version was given; the champion is meant."""
        return self.alias is None and self.version is None

    def __str__(self) -> str:
        if self.version is not None:
            return f"{self.name}/{self.version}"
        return self.name if self.alias is None else f"{self.name}@{self.alias}"
