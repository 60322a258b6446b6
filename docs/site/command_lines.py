"""The page of command lines, made of what each command says of itself."""

import sys
from argparse import ArgumentParser, _SubParsersAction
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any
from unittest.mock import patch

INTRODUCTION = """\
# Command lines

What `--help` says, as the commands themselves say it. All are run in the project's environment; `make` prints
its targets.
"""


@dataclass(frozen=True, slots=True)
class Command:
    """One command.

    Args:
        line: as it is typed.
        module: that holds its ``main``.
        name: of what is called there; dots for members.
        leading: words without which another command answers.
    """

    line: str
    module: str
    name: str = "main"
    leading: tuple[str, ...] = ()


COMMANDS = (
    Command("python -m services.local", "services.local.__main__"),
    Command("python training/cluster_train.py", "training.cluster_train", "COMMAND.main"),
    Command("python training/path_train.py", "training.path_train", "COMMAND.main"),
    Command("python -m training.path_sampler", "training.path_sampler"),
    Command("python -m training.plan_confidence", "training.plan_confidence"),
    Command("python -m training.scene_model", "training.scene_model"),
    Command("python -m training.field", "training.field"),
    Command("python -m training.untrained", "training.untrained"),
    Command("python -m training.data", "training.data.__main__"),
    Command("python -m training.robots", "training.robots.__main__"),
    Command("python -m training.motionbench", "training.motionbench"),
    Command("python -m services.evaluator", "services.evaluator.__main__"),
    Command(
        "python -m services.evaluator recalibrate", "services.evaluator.__main__", leading=("recalibrate",)
    ),
    Command("python -m services.evaluator planning", "services.evaluator.__main__", leading=("planning",)),
    Command("python -m services.planner", "services.planner.__main__"),
    Command("python -m services.registry", "services.registry.__main__"),
    Command("python -m inference_api", "inference_api.__main__"),
)


class _Parsing(BaseException):
    """Ends a command where it would parse, with its parser; no command catches it."""

    def __init__(self, parser: ArgumentParser) -> None:
        super().__init__()
        self.parser = parser


def markdown() -> str:
    """The page."""
    return "\n".join([INTRODUCTION, *(part for command in COMMANDS for part in _parts(command))])


def parser_of(command: Command) -> ArgumentParser:
    """The parser of a command, which runs up to where it would parse.

    Raises:
        LookupError: it does not parse.
    """

    def stop(parser: ArgumentParser, *_: Any, **__: Any) -> None:
        raise _Parsing(parser)

    called: Any = import_module(command.module)
    for part in command.name.split("."):
        called = getattr(called, part)
    program = command.line.removeprefix("python ")
    with patch.object(ArgumentParser, "parse_args", stop), patch.object(sys, "argv", [program]):
        try:
            called(list(command.leading))
        except _Parsing as parsing:
            return parsing.parser
    raise LookupError(f"{command.line} parses no command line")


def _parts(command: Command) -> Iterator[str]:
    parser = parser_of(command)
    yield from _section(f"## `{command.line}`", parser)
    for names, sub in _below(parser):
        yield from _section(f"### `{command.line} {' '.join(names)}`", sub)


def _section(heading: str, parser: ArgumentParser) -> Sequence[str]:
    with patch.dict("os.environ", {"COLUMNS": "100"}):
        return heading, "", "```text", parser.format_help().rstrip(), "```", ""


def _below(parser: ArgumentParser) -> Iterator[tuple[tuple[str, ...], ArgumentParser]]:
    """Commands below a command, at any depth, by their words."""
    for action in parser._actions:  # noqa: SLF001 - argparse shows its subcommands nowhere else
        if isinstance(action, _SubParsersAction):
            for name, sub in action.choices.items():
                yield (name,), sub
                yield from (((name, *names), last) for names, last in _below(sub))
