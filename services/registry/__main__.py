"""Registered models: ``python -m services.registry models list|show|history|promote|rollback|...``."""

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path

from cspace.errors import CspaceError, InputError, ModelNotFoundError
from services.commands import confirmed, report_error
from services.names import ALIAS_CHAMPION, TAG_SIGNATURE
from services.registry import promotion, tracking_uri
from services.registry.entities import ModelReference, ModelVersion
from services.registry.models import ModelRegistry
from services.registry.promotion import PREFIX, Decision, decisions_of, utc
from services.registry.tracking import Tracking

_Run = Callable[[ModelRegistry, argparse.Namespace], None]


def main(arguments: Sequence[str] | None = None, environment: Mapping[str, str] = os.environ) -> int:
    """Parse, do it, print; returns the exit code."""
    options = _parser().parse_args(arguments)
    try:
        options.uri = tracking_uri(environment)
        options.run(ModelRegistry(options.uri), options)
    except CspaceError as error:
        return report_error(error, InputError, ModelNotFoundError)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.registry",
        description="Registered models. MLFLOW_TRACKING_URI is the tracking server's address.",
        epilog="Exit codes: 0 done, 1 the registry or a bundle failed, 2 the request was wrong.",
    )
    models = parser.add_subparsers(required=True, metavar="models").add_parser("models", help="versions")
    commands = models.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, run: _Run, words: str, what: str = "") -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words)
        command.set_defaults(run=run)
        if what:
            command.add_argument(
                what, help="of the model" if what == "name" else "name, name@alias or name/version"
            )
        return command

    add("list", _list, "the models, or the versions of one").add_argument("name", nargs="?", default="")
    add("show", _show, "a version with its tags and the decisions about it", "version")
    add("history", _history, "which version was the champion when", "name")
    promote = add("promote", _promote, "make a version the champion, whatever the gate says", "version")
    back = add("rollback", _roll_back, "make the champion before the present one champion again", "name")
    for one in (promote, back):
        one.add_argument("--reason", required=True, help="kept with the decision")
    delete = add("delete", _delete, "delete a version that no alias names", "version")
    delete.add_argument("--yes", action="store_true", help="do not ask")
    add("export", _export, "write a version's bundle", "version").add_argument("folder", type=Path)
    sign = add("sign", _sign, "sign a version's bundle, for servers that want it", "version")
    key = "PEM file of an elliptic curve's private key"
    sign.add_argument("--key", type=Path, required=True, help=key)
    imported = add("import", _import, "register a bundle as the challenger")
    imported.add_argument("folder", type=Path)
    imported.add_argument("name", help="of the model, which is created when it is new")
    return parser


def _list(registry: ModelRegistry, options: argparse.Namespace) -> None:
    if not options.name:
        for name in registry.names():
            newest = registry.versions(name)
            champion = next((one.number for one in newest if ALIAS_CHAMPION in one.aliases), "-")
            print(f"{name:<40} {len(newest):>4} versions, champion {champion}")
        return
    for version in registry.versions(options.name):
        decisions = decisions_of(version)
        metrics = decisions[-1].metrics if decisions else {}
        figures = ", ".join(f"{key} {value:.3f}" for key, value in metrics.items())
        print(f"{version!s:<30} {utc(version.created_ms)}  {', '.join(version.aliases):<22} {figures}")


def _show(registry: ModelRegistry, options: argparse.Namespace) -> None:
    version = _version(registry, options)
    print(f"{version}  {', '.join(version.aliases)}")
    print(f"  made      {utc(version.created_ms)} by run {version.run_id}")
    for key, value in sorted(version.tags.items()):
        if not key.startswith(PREFIX):
            print(f"  {key:<9} {'by a key' if key == TAG_SIGNATURE else value}")
    for decision in decisions_of(version):
        print(f"  {utc(decision.created_ms)}  {'promoted' if decision.promoted else 'not promoted'}")
        for reason in decision.reasons:
            print(f"    - {reason}")


def _history(registry: ModelRegistry, options: argparse.Namespace) -> None:
    found = promotion.champions(registry, options.name)
    if not found:
        print(
            f"{registry.by_alias(options.name, ALIAS_CHAMPION)} is the champion, and no decision is recorded"
        )
    for one, after in zip_longest(found, found[1:]):
        until = utc(after.created_ms) if after else ""
        print(f"{options.name}/{one.version:<6} {utc(one.created_ms)}  to  {until:<23}  {one.reasons[0]}")


def _promote(registry: ModelRegistry, options: argparse.Namespace) -> None:
    _print_decision(promotion.promote(registry, _version(registry, options), options.reason))


def _roll_back(registry: ModelRegistry, options: argparse.Namespace) -> None:
    _print_decision(promotion.roll_back(registry, options.name, options.reason))


def _delete(registry: ModelRegistry, options: argparse.Namespace) -> None:
    version = _version(registry, options)
    if not options.yes and not confirmed(f"delete {version} for good?"):
        print("nothing was deleted")
        return
    promotion.delete(registry, version)
    print(f"deleted {version}")


def _export(registry: ModelRegistry, options: argparse.Namespace) -> None:
    version = _version(registry, options)
    print(f"{version} is in {registry.download(version, options.folder)}")


def _sign(registry: ModelRegistry, options: argparse.Namespace) -> None:
    version = _version(registry, options)
    promotion.sign(registry, version, options.key)
    print(f"{version} is signed; servers that ask for this key serve it")


def _import(registry: ModelRegistry, options: argparse.Namespace) -> None:
    tracking = Tracking(options.uri)
    version = promotion.import_version(registry, tracking, options.folder, options.name)
    print(f"{version} is the challenger; evaluate it: python -m services.evaluator --model {version}")


def _version(registry: ModelRegistry, options: argparse.Namespace) -> ModelVersion:
    return registry.look_up(ModelReference.parse(options.version))


def _print_decision(decision: Decision) -> None:
    before = "" if decision.against is None else f", version {decision.against} before"
    print(f"champion of {decision.name} is version {decision.version}{before}")


if __name__ == "__main__":
    sys.exit(main())
