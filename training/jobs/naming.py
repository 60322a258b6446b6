"""The registered model of a job's robot."""

from functools import partial
from typing import TypeVar

from cspace.errors import ConfigError
from cspace.world import World
from cspace.worlds import robot_digest
from services.names import TAG_ROBOT, model_name
from services.registry.models.mlflow_registry import MlflowRegistry
from training.config.job import JobConfig
from training.jobs.job import Job

Config = TypeVar("Config", bound=JobConfig)


def registered_name(job: Job[Config], world: World, given: str | None, *, path: bool) -> str:
    """The name under which a job registers; to be asked before the long work.

    Args:
        job: under way.
        world: whose robot it trains for.
        given: the robot's name in its configuration.
        path: whether the model is one of paths.

    Raises:
        ConfigError: the name is another robot's, or the registry has versions of another robot under it.
        RegistryUnavailableError: the registry stayed away.
    """
    digest, name = robot_digest(world), model_name(world, given, path=path)
    if given is None:
        return name
    registry = MlflowRegistry(job.environment.tracking_uri)
    for model in {model_name(world, given, path=kind) for kind in (False, True)}:
        versions = job.patiently(f"looking at {model}", partial(registry.versions, model))
        other = next((one for one in versions if one.tags.get(TAG_ROBOT, digest) != digest), None)
        if other is not None:
            raise ConfigError(
                "robot_name is another robot's",
                expected=f"a name whose models are of robot {digest[:8]}",
                got=f"{given}, and {other} is of robot {other.tags[TAG_ROBOT][:8]}",
                remedy="set robot_name to another name",
            )
    return name
