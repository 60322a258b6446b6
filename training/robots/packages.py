"""Packages of files, and the expansion of xacro files by the package xacro.

A xacro file holds Python expressions. They are evaluated only if all their parts are on a list
(:func:`check`), and files are read only from the packages of the description. The expansion runs in a process
that the kernel bounds (:mod:`cspace.bounded`).
"""

import ast
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cspace.errors import ScenarioError

_MAX_CHARACTERS = 16_000_000
# Numbers, strings, collections, arithmetic, comparisons, calls and members. No functions, no comprehensions.
_ALLOWED = (
    ast.Expression, ast.Constant, ast.Name, ast.Load, ast.List, ast.Tuple, ast.Dict, ast.Set, ast.BinOp,
    ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Subscript, ast.Slice, ast.Call, ast.keyword,
    ast.Attribute, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
# Members that reach others by their text, or types.
_FORBIDDEN = {"format", "format_map", "mro"}


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


def check(expression: str) -> None:
    """Refuse an expression that could do more than compute.

    Raises:
        ValueError: it has a part that is not on the list, or a member that begins with an underscore.
    """
    for node in ast.walk(ast.parse(expression.strip(), mode="eval")):
        name = node.attr if isinstance(node, ast.Attribute) else ""
        name = name or (node.id if isinstance(node, ast.Name) and node.id.startswith("__") else "")
        if not isinstance(node, _ALLOWED) or name.startswith("_") or name in _FORBIDDEN:
            part = name or type(node).__name__
            raise ValueError(f"{part} is not allowed in an expression: {expression[:100]}")


def expand(file: str, packages: Mapping[str, str], arguments: Mapping[str, str]) -> str:
    """The text of a xacro file with its macros expanded; to be called in a bounded process.

    Raises:
        ScenarioError: xacro cannot expand it.
    """
    import xacro  # noqa: PLC0415 - in the worker alone

    os.environ.clear()
    _restrict(xacro, Path(file).resolve().parent, {name: Path(one) for name, one in packages.items()})
    try:
        text = str(xacro.process_file(file, mappings=dict(arguments)).toxml())
    except MemoryError:
        raise
    except Exception as problem:  # whatever a stranger's file makes xacro raise
        raise ScenarioError(
            f"xacro cannot expand {Path(file).name}",
            expected="macros and expressions as xacro documents them, and files of its packages alone",
            got=" ".join(f"{type(problem).__name__}: {problem}".split())[:400],
            remedy="give arguments by --xacro NAME=VALUE and folders of packages by --package NAME=FOLDER",
        ) from problem
    if len(text) > _MAX_CHARACTERS:
        raise ScenarioError(
            f"{Path(file).name} is too large when it is expanded",
            expected=f"at most {_MAX_CHARACTERS} characters",
            got=str(len(text)),
        )
    return text


def _restrict(xacro: Any, folder: Path, packages: Mapping[str, Path]) -> None:
    """Have xacro check expressions, find packages as they are given, and open files of these alone."""
    from xacro import substitution_args  # noqa: PLC0415

    allowed = [package_of(folder).resolve(), *(one.resolve() for one in packages.values())]

    def find(name: str) -> str:
        for root in package_roots(name, folder, packages):
            allowed.append(root.resolve())
            return str(root)
        raise ValueError(f"package {name} is not found; say where it lies with --package {name}=FOLDER")

    def open_own(path: str) -> Any:
        real = Path(path).resolve()
        if not real.is_file() or not any(real.is_relative_to(root) for root in allowed):
            raise FileNotFoundError(2, "no file of the description's packages", str(path))
        return real.open(encoding="utf-8")

    def checked(evaluate: Callable[..., Any]) -> Callable[..., Any]:
        def evaluated(expression: str, *others: Any) -> Any:
            check(expression)
            return evaluate(expression, *others)

        return evaluated

    xacro.open, xacro.safe_eval = open_own, checked(xacro.safe_eval)
    for name in ("type", "vars"):
        del xacro._global_symbols["python"][name]  # noqa: SLF001
    substitution_args._eval = checked(substitution_args._eval)  # noqa: SLF001
    # As xacro's documentation of use without ROS does.
    substitution_args._eval_find = find  # noqa: SLF001
    substitution_args._eval_dict["find"] = find  # noqa: SLF001
