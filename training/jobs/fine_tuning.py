"""Fine-tuning: the job whose weights a new one starts from, found and compared before anything starts."""

import json
import re
from pathlib import Path

from pydantic import ValidationError

from cspace.bundle import BundleSpec
from cspace.errors import BundleError, ConfigError
from services.registry.entities import ModelReference
from services.registry.errors import retry
from services.registry.models import ModelRegistry
from training.config import JobConfig
from training.jobs.environment import RECORD, Environment, job_folder

_RUN_ID = re.compile(r"[0-9a-f]{32}")
_SPEC = "bundle.json"


def earlier_job(config: JobConfig, start_from: str, environment: Environment) -> str:
    """The run of the job that ``start_from`` means, whose networks are of the configuration's shapes."""
    run_id = start_from if _RUN_ID.fullmatch(start_from) else _maker(start_from, environment)
    folder = _owner(run_id, environment)
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
        earlier = type(config).model_validate(record["config"])
    except (ValidationError, ValueError, KeyError) as error:
        raise ConfigError(
            f"start_from={start_from} is a job of another kind",
            expected=f"one that {type(config).__name__} describes",
            got=type(error).__name__,
        ) from error
    missing = [name for name in config.KEPT if not (folder / name).is_file()]
    if missing:
        raise ConfigError(
            f"start_from={start_from} cannot be gone on from",
            expected=f"{', '.join(missing)} in {folder}",
            got="a job of a release that did not keep it, or one that has not finished",
            remedy="train without start_from once",
        )
    _require_equal(earlier.shapes, config.shapes, start_from)
    robot, ours = _world(folder, start_from), config.world.to_dict()
    setting = "data.robot" if config.data_folder is None else "data_folder"
    if robot != ours:
        raise ConfigError(
            f"{setting} is not of the robot and the camera of start_from={start_from}",
            expected=json.dumps(robot),
            got=json.dumps(ours),
            remedy="train without start_from",
        )
    return folder.name


def require_folder(folder: Path) -> Path:
    """A job's folder, whose weights another one starts from."""
    if (folder / RECORD).is_file():
        return folder
    raise ConfigError(
        "the weights that start_from means are gone",
        expected=f"the folder {folder} of the job that made them",
        got="none: it was deleted, or the version was imported or made in another data folder",
        remedy="put the folder back, name another version, or train without start_from",
    )


def _maker(start_from: str, environment: Environment) -> str:
    reference = ModelReference.parse_version(
        start_from, "start_from does not fit", "name@alias, name/version or a run's id"
    )
    return retry(
        f"looking {start_from} up",
        lambda: ModelRegistry(environment.tracking_uri).look_up(reference).run_id,
        environment.patience_s,
    )


def _owner(run_id: str, environment: Environment) -> Path:
    """The folder of the job of a run, or of the trial of a run: path models are registered by their own."""
    folder = job_folder(environment, run_id)
    if not folder.is_dir():
        for record in folder.parent.glob(f"*/{RECORD}"):
            if run_id in json.loads(record.read_text(encoding="utf-8"))["children"].values():
                return record.parent
    return require_folder(folder)


def _world(folder: Path, start_from: str) -> object:
    made = [*folder.glob(f"bundle/{_SPEC}"), *folder.glob(f"bundles/*/{_SPEC}")]
    try:
        return BundleSpec.from_json(made[0].read_bytes()).world.to_dict()
    except (IndexError, OSError, BundleError) as error:
        raise ConfigError(
            f"start_from={start_from} is a job that has not finished",
            expected=f"its bundle in {folder}",
            remedy="let it finish, or name another version",
        ) from error


def _require_equal(there: dict[str, str], wanted: dict[str, str], start_from: str) -> None:
    other = [key for key in sorted(there.keys() | wanted.keys()) if there.get(key) != wanted.get(key)]
    if other:
        raise ConfigError(
            f"{', '.join(other[:5])} differ from those of start_from={start_from}",
            expected=", ".join(f"{key}={there.get(key)}" for key in other[:5]),
            got=", ".join(f"{key}={wanted.get(key)}" for key in other[:5]),
            remedy="set them as they were, or train without start_from",
        )
