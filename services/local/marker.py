"""The mark on a state folder that this project made: without it, nothing there is written or deleted."""

import json
from collections.abc import Sequence
from pathlib import Path

from cspace.errors import ConfigError
from cspace.files import ignore, write_json

MARKER = ".cspace-sampler.json"


def claim(home: Path, parts: Sequence[str]) -> None:
    """Mark a folder as this project's, with the names of what it keeps there.

    A new or empty folder is marked and ignores itself. So is marked what an earlier release made, which holds
    a registry and nothing but this project's parts.

    Raises:
        ConfigError: it holds something else.
        OSError: it cannot be made or written.
    """
    home.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not marked(home):
        found = _names(home)
        if found and not _made_earlier(home, parts):
            raise ConfigError(
                f"{home} is not a state folder of this project",
                expected="a new or an empty folder",
                got=", ".join(found[:5]) + (f" and {len(found) - 5} more" if len(found) > 5 else ""),
                remedy="set CSPACE_HOME to a folder of its own",
            )
        write_json(home / MARKER, {"made_by": "cspace-sampler", "parts": list(parts)})
        if not found:
            ignore(home)


def marked(home: Path) -> bool:
    """Whether the folder bears the mark."""
    return (home / MARKER).is_file()


def owned(home: Path, parts: Sequence[str]) -> tuple[str, ...]:
    """Those parts that the mark lists, or that an earlier release left; none where there is no folder.

    Raises:
        ConfigError: the folder is not this project's, or its mark is damaged.
    """
    if not home.is_dir():
        return ()
    if not marked(home) and _made_earlier(home, parts):
        return tuple(parts)
    try:
        listed = json.loads((home / MARKER).read_text(encoding="utf-8"))["parts"]
        return tuple(name for name in parts if name in listed)
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ConfigError(
            f"{home} is not a state folder of this project",
            expected=f"{MARKER} in it, which `make up` writes",
            got=f"{type(error).__name__} on reading it",
            remedy="see what CSPACE_HOME says, or delete the folder yourself",
        ) from error


def _made_earlier(home: Path, parts: Sequence[str]) -> bool:
    return (home / "mlflow" / "mlflow.db").is_file() and set(_names(home)) <= set(parts)


def _names(home: Path) -> list[str]:
    return sorted(path.name for path in home.iterdir()) if home.is_dir() else []
