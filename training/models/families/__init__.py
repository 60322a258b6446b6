"""Model families by name: a module of this package each, which is found by itself.

A family's module holds its settings, networks, loss, training step and sampler::

    class ToyConfig(TrainConfig):
        toy: ToySettings = ToySettings()


    @register("toy")
    class Toy(Family[ToyConfig]):
        configuration = ToyConfig
        ...

The main job trains the family that ``clusters.form`` names.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, ClassVar, Generic, TypeVar

from cspace.bundle.spec import ModelKind
from cspace.errors import ConfigError
from training.config import TrainConfig, TrialSettings
from training.models.data import TrainingArrays
from training.models.export import Sampler
from training.models.modules import TrialModule

Config = TypeVar("Config", bound=TrainConfig)
# Checkpoints by the names of the trials that are finished.
Checkpoints = Mapping[str, Path]


@dataclass(frozen=True, slots=True)
class Trial:
    """What a trial trains, by which settings, and what its run is compared by beside them."""

    module: TrialModule
    settings: TrialSettings
    parameters: Mapping[str, Any] = field(default_factory=dict)


class Family(ABC, Generic[Config]):
    """Trains a kind of generator on configurations and latents, and makes a sampler of the result."""

    configuration: ClassVar[type[TrainConfig]]
    # In the bundle's specification.
    model_kind: ClassVar[ModelKind] = "generator"

    def __init__(self, config: Config, arrays: TrainingArrays) -> None:
        self.config, self.arrays = config, arrays

    @abstractmethod
    def stages(self) -> Mapping[str, Sequence[str]]:
        """Names of the trials by stage; stages run one after the other, the trials of one side by side."""

    @abstractmethod
    def trial(self, name: str, seed: int, done: Checkpoints) -> Trial:
        """What the trial of this name trains, after those of the stages before."""

    @abstractmethod
    def sampler(self, done: Checkpoints) -> Sampler:
        """The sampler that the bundle holds."""


_FAMILIES: dict[str, type[Family[Any]]] = {}
Kind = TypeVar("Kind", bound=type[Family[Any]])


def register(name: str) -> Callable[[Kind], Kind]:
    """Register a family under the name that ``clusters.form`` takes."""

    def add(kind: Kind) -> Kind:
        _FAMILIES[name] = kind
        return kind

    return add


def family(name: str) -> type[Family[Any]]:
    """The family of this name."""
    _import_all()
    if name not in _FAMILIES:
        raise ConfigError("clusters.form is unknown", expected=", ".join(sorted(_FAMILIES)), got=repr(name))
    return _FAMILIES[name]


def families() -> Mapping[str, type[Family[Any]]]:
    """All of them by name."""
    _import_all()
    return dict(sorted(_FAMILIES.items()))


@cache
def _import_all() -> None:
    for module in iter_modules(__path__):
        import_module(f"{__name__}.{module.name}")
