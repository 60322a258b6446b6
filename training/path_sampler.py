"""``python -m training.path_sampler BUNDLE FOLDER``: a path sampler of a bundle's validity head.

Nothing is trained: paths are searched for when samples are requested, the head chooses among them, and
samples are drawn along them. The command writes a bundle of the kind ``path``, which the inference API
serves like any other; with ``--register`` it becomes a version of ``path-sampler``, or of
``<robot>-path-sampler`` for a robot other than the default one.

A folder that holds this very path sampler already is taken as it is, so that the command may be given again.

Exit codes: 0 done, 1 the bundle, the disk or the registry is bad, 2 the command is wrong.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from cspace.bundle import Bundle
from cspace.bundle.verification import load_verified
from cspace.errors import ConfigError, CspaceError, InputError
from services.command_errors import report_error
from services.names import ALIAS_CHALLENGER, ALIAS_CHAMPION, EXPERIMENT, TAG_STAGE, model_name, recorded_name
from services.registry.ports import ID
from training.jobs.job import world_tag
from training.paths.writing import made_or_found


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse, make, print."""
    options = parser().parse_args(arguments)
    try:
        uri = None if options.register is None else _registry_uri()
        source = load_verified(options.bundle)
        named = options.robot_name or recorded_name(source.spec.provenance.config)
        model = model_name(source.spec.world, named, path=True)
        bundle = made_or_found(source, options.folder)
        print(f"{bundle.folder}\n  digest {bundle.digest}")
        if uri is not None:
            print(f"  registered as {register(bundle, uri, model, options.register)}")
    except CspaceError as error:
        return report_error(error, InputError)
    return 0


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.path_sampler",
        description="Make a path sampler of a bundle's validity head; nothing is trained.",
        epilog="Reads MLFLOW_TRACKING_URI with --register. Exit codes: 0 done, 1 failed, 2 bad input.",
    )
    parser.add_argument("bundle", type=Path, help="a bundle with a validity head")
    parser.add_argument("folder", type=Path, help="where the path sampler goes")
    parser.add_argument(
        "--register",
        choices=(ALIAS_CHALLENGER, ALIAS_CHAMPION),
        help="make it a version of the robot's model of paths with this alias",
    )
    parser.add_argument("--robot-name", help="as of training jobs (default: the one in the bundle)")
    return parser


def register(bundle: Bundle, uri: str, model: str, alias: str) -> str:
    """Make a bundle the next version of a path model, by a run that holds its settings; ``name/version``.

    Raises:
        RegistryError: the registry at ``uri`` does not answer.
    """
    # MLflow takes seconds to import.
    from services.registry.mlflow_registry import MlflowRegistry  # noqa: PLC0415
    from services.registry.mlflow_tracking import MlflowTracking  # noqa: PLC0415

    provenance = bundle.spec.provenance
    tags = {TAG_STAGE: "path-sampler", **world_tag(bundle.spec.world, recorded_name(provenance.config))}
    with MlflowTracking(uri).start(EXPERIMENT, f"{model}, untrained, {ID}", tags=tags) as run:
        run.params(dict(provenance.config))
        version = MlflowRegistry(uri).register(
            model,
            bundle.folder,
            run.run_id,
            bundle.digest,
            {
                "data_digest": provenance.data_digest or "",
                "source_digest": provenance.config["source_digest"],
            },
            alias=alias,
        )
    return str(version)


def _registry_uri() -> str:
    uri = os.environ.get("MLFLOW_TRACKING_URI")
    if not uri:
        raise ConfigError(
            "there is no registry", expected="its address in MLFLOW_TRACKING_URI", got="nothing"
        )
    return uri


if __name__ == "__main__":
    sys.exit(main())
