"""Models that answer: versions of the registry, and those that are shipped with the server."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock

from cspace.bundle import Bundle, BundleSpec
from cspace.bundle.files import SPEC_FILE, read_files
from cspace.errors import BundleError
from cspace.worlds import robot_digest
from inference_api.problem_types import ModelNotReadyError
from services.names import may_name, model_name, recorded_name
from services.registry.entities import PRETRAINED, ModelVersion

PRETRAINED_VERSION = 0
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ServedModel:
    """A loaded bundle with the name under which it answers.

    Args:
        bundle: the bundle.
        name: of the registered model, or ``pretrained``.
        version: its number in the registry, 0 for the shipped model.
        alias: by which it was found, None when it was not.
        run_id: the training run, None for the shipped model.
        fallback: whether the shipped model stands in for a champion.
        confirmed: whether the registry, asked last, says that the alias stands for this version.
    """

    bundle: Bundle
    name: str
    version: int
    alias: str | None = None
    run_id: str | None = None
    fallback: bool = False
    confirmed: bool = True

    def __str__(self) -> str:
        return f"{self.name}/{self.version}"

    @classmethod
    def of(
        cls, bundle: Bundle, version: ModelVersion, alias: str | None, *, confirmed: bool = True
    ) -> "ServedModel":
        """A version of the registry."""
        return cls(bundle, version.name, version.number, alias, version.run_id or None, confirmed=confirmed)


@dataclass(frozen=True, slots=True)
class Shipped:
    """A shipped model, loaded or not.

    Args:
        name: ``pretrained``, or with a robot behind it.
        spec: of its bundle.
        digest: of the bundle.
        loaded: None before it was asked for.
    """

    name: str
    spec: BundleSpec
    digest: str
    loaded: ServedModel | None

    def fits(self, model: str, robot: str | None) -> bool:
        """Whether it may stand in for a registered model.

        Args:
            model: its name.
            robot: SHA-256 of its robot; None where that is not known, and the name decides.
        """
        if robot is not None:
            return robot == robot_digest(self.spec.world)
        if self.name == PRETRAINED:
            return may_name(model, self.spec.world, recorded_name(self.spec.provenance.config))
        return model == self.registered

    @property
    def registered(self) -> str:
        """The registered model that training it again would make a version of."""
        return model_name(self.spec.world, recorded_name(self.spec.provenance.config))


class ShippedModels:
    """The first in memory from the start, others when first asked for; safe to share between threads.

    Args:
        folders: bundles by name, ``pretrained`` first.
    """

    def __init__(self, folders: Mapping[str, Path]) -> None:
        self._folders = dict(folders)
        self._lock = Lock()
        self._found: dict[str, Shipped] = {}

    def __iter__(self) -> Iterator[Shipped]:
        return iter(list(self._found.values()))

    def __contains__(self, name: str) -> bool:
        return name in self._folders

    def look(self) -> None:
        """Load the first, and read the descriptions of the others; what is not usable is logged."""
        for name, folder in self._folders.items():
            try:
                if name == PRETRAINED:
                    self._load(name)
                else:
                    files = read_files(folder)
                    spec = BundleSpec.from_json(files.contents[SPEC_FILE])
                    self._found.setdefault(name, Shipped(name, spec, files.digest, None))
            except BundleError as error:
                _LOG.warning("the shipped model %s is not usable: %s", name, error)

    def is_usable(self, name: str) -> bool:
        """Whether there was a bundle when the store was loaded."""
        return name in self._found

    def peek(self, name: str, *, fallback: bool = False) -> ServedModel | None:
        """A model that is in memory; perhaps as what stands in for a registered one."""
        found = self._found.get(name)
        loaded = None if found is None else found.loaded
        return loaded if loaded is None else replace(loaded, fallback=fallback)

    def get(self, name: str, *, fallback: bool = False) -> ServedModel:
        """The same, loaded now where it was not.

        Raises:
            ModelNotReadyError: it cannot be served.
        """
        try:
            return replace(self._load(name), fallback=fallback)
        except BundleError as error:
            raise ModelNotReadyError(
                f"the shipped model {name} cannot be served", expected="a sound bundle", got=error.what
            ) from error

    def named_after(self, model: str) -> str | None:
        """The name of the further one that was registered under a name, if any."""
        further = (one for one in self if one.name != PRETRAINED)
        return next((one.name for one in further if one.registered == model), None)

    def stand_in(self, model: str, robot: str | None) -> ServedModel | None:
        """The first that may stand in for a registered model, loaded; None without one."""
        for one in self:
            if one.fits(model, robot):
                with suppress(ModelNotReadyError):
                    return self.get(one.name, fallback=True)
        return None

    def _load(self, name: str) -> ServedModel:
        # One at a time: two requests at once would have the memory of two.
        with self._lock:
            found = self.peek(name)
            if found is None:
                # It comes with the program, or the operator chose it: its graphs are trusted.
                bundle = Bundle.load(self._folders[name], check=False, replay=True)
                found = ServedModel(bundle, name, PRETRAINED_VERSION)
                self._found[name] = Shipped(name, bundle.spec, bundle.digest, found)
            return found
