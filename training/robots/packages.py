"""Packages of files, and the expansion of xacro files, which this module does when it is run as a script.

xacro evaluates Python expressions of whoever wrote the file, so it runs in a process of its own: without the
environment, with bounds of time and memory, and with an audit hook that lets it read files of the packages of
the description alone.
"""

import errno
import json
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

_HARMLESS = ("builtins", "code", "compile", "exec", "import", "marshal", "object", "sys")
_MEMORY_BYTES, _CPU_S, _MAX_CHARACTERS = 400_000_000, 5, 16_000_000


def package_of(folder: Path) -> Path:
    """The nearest folder above that is a package, by its ``package.xml``; else the folder itself."""
    return next((one for one in (folder, *folder.parents) if (one / "package.xml").is_file()), folder)


def package_roots(name: str, folder: Path, packages: Mapping[str, Path]) -> list[Path]:
    """Where a package may lie: as given, else above the description or beside these folders."""
    if name in packages:
        return [packages[name]]
    if not re.fullmatch(r"\w[\w.-]{,99}", name):
        return []
    # A folder that says it is a package, or the description's own in a copy that left this out.
    places = [root for one in (folder, *folder.parents) for root in (one / name, one) if root.name == name]
    found = [root for root in places if (root / "package.xml").is_file()]
    return found + [one for one in (folder, folder.parent) if one.name == name and len(one.parts) > 2]


def _expand(file: str, packages: dict[str, str], arguments: dict[str, str]) -> str:
    """The expanded text of a xacro file."""
    import resource  # noqa: PLC0415 # of the script alone
    from xml.dom import expatbuilder  # noqa: F401, PLC0415

    import xacro  # noqa: PLC0415

    # xacro imports these when no file of theirs can be read.
    import yaml  # noqa: F401, PLC0415
    from xacro import substitution_args  # noqa: PLC0415

    folder, given = Path(file).resolve().parent, {name: Path(one) for name, one in packages.items()}
    allowed = [package_of(folder).resolve(), *(one.resolve() for one in given.values())]

    def find(name: str) -> str:
        for root in package_roots(name, folder, given):
            allowed.append(root.resolve())
            return str(root)
        raise ValueError(f"package {name} is not found; say where it lies with --package {name}=FOLDER")

    def audit(event: str, details: tuple[object, ...]) -> None:
        if event == "open":
            path, mode = details[:2]
            real = Path(os.path.realpath(path)) if isinstance(path, str) else Path("/")
            # A pipe has no end.
            if (
                mode in {"r", "rb"}
                and any(real.is_relative_to(root) for root in allowed)
                and not real.is_fifo()
            ):
                return
            raise PermissionError(errno.EACCES, "outside of the description's packages", str(real))
        if event.partition(".")[0] not in _HARMLESS:
            raise PermissionError(f"xacro may not use {event}")

    substitution_args._eval_find = find  # noqa: SLF001 # as xacro's documentation of use without ROS does
    substitution_args._eval_dict["find"] = find  # noqa: SLF001
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    # The first ends the process by SIGXCPU.
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S + 1))
    sys.addaudithook(audit)
    text = str(xacro.process_file(file, mappings=arguments).toxml())
    if len(text) > _MAX_CHARACTERS:
        raise ValueError(f"it has {len(text)} characters when it is expanded, more than {_MAX_CHARACTERS}")
    return text


if __name__ == "__main__":
    try:
        _request = json.loads(sys.stdin.read())
        sys.stdout.write(_expand(_request["file"], _request["packages"], _request["arguments"]))
    except Exception as problem:  # noqa: BLE001 # whatever a stranger's file makes xacro raise
        sys.stderr.write(f"{type(problem).__name__}: {problem}"[:500])
        sys.exit(1)
