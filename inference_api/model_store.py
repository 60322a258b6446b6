"""Which bundle answers which reference: the champion in service, others on demand, the shipped one else.

The champion is looked up in the background (:meth:`ModelStore.refresh`), so that a promotion is served
without a restart and no request waits for the registry. A champion that is refused, or a registry that is
away, leaves the one in service. With no champion at all the shipped bundle answers, and the answer says so.
"""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from cspace.bundle import Bundle
from cspace.errors import (
    BundleError,
    CspaceError,
    GoldenMismatchError,
    ModelNotFoundError,
    RegistryError,
    StorageError,
)
from inference_api.bundle_cache import BundleCache
from inference_api.pictures import PictureCache
from inference_api.references import CHAMPION, PRETRAINED, ModelReference
from inference_api.registry_view import RegistryView
from inference_api.telemetry.observer import Nobody, Observer, Refusal
from services.registry.models import ModelRegistry, ModelVersion

_LOG = logging.getLogger(__name__)
PRETRAINED_VERSION = 0
# A champion that could not be put into service is tried again, but not at every look.
RETRY_S = 15.0


class ModelNotReadyError(CspaceError):
    """There is no model that could answer."""


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
    """

    bundle: Bundle
    name: str
    version: int
    alias: str | None = None
    run_id: str | None = None
    fallback: bool = False


class ModelStore:
    """Bundles by reference; safe to share between threads.

    Args:
        registry: None serves the shipped model only.
        cache: of downloaded bundles.
        pretrained_folder: the shipped bundle.
        model_name: whose champion is the default.
        lookup_s: how long a looked-up version or alias is trusted.
        clock: seconds, monotonic.
        pictures: those that were encoded already; none are kept when None.
    """

    def __init__(
        self,
        registry: ModelRegistry | None,
        cache: BundleCache,
        pretrained_folder: Path,
        model_name: str,
        lookup_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        pictures: PictureCache | None = None,
    ) -> None:
        self.observer: Observer = Nobody()
        self.pictures = PictureCache(0) if pictures is None else pictures
        self.model_name = model_name
        self._cache = cache
        self._view = None if registry is None else RegistryView(registry, cache, lookup_s, clock)
        self._pretrained_folder = pretrained_folder
        self._clock = clock
        self._champion: ServedModel | None = None
        self._shipped: ServedModel | None = None
        self._refused: tuple[str, float] = ("", 0.0)

    @property
    def registry_state(self) -> Literal["none", "reachable", "unreachable"]:
        """Whether the registry answered when it was asked last."""
        if self._view is None:
            return "none"
        return "unreachable" if self._view.is_away else "reachable"

    @property
    def shipped(self) -> ServedModel | None:
        """The shipped model, None without a usable one."""
        return self._shipped

    @property
    def default(self) -> ServedModel | None:
        """The model that answers requests that name none, None without one."""
        if self._champion is None and self._shipped is not None:
            return replace(self._shipped, fallback=True)
        return self._champion

    def load_shipped(self) -> None:
        """Load the shipped bundle; without a usable one the reason is logged and the store goes on."""
        try:
            bundle = Bundle.load(self._pretrained_folder)
        except BundleError as error:
            _LOG.warning("the shipped model is not usable: %s", error)
        else:
            self._shipped = ServedModel(bundle, PRETRAINED, PRETRAINED_VERSION)

    def refresh(self) -> None:
        """Look up the champion and what requests named lately; the project's errors are not raised."""
        if self._view is not None:
            self._follow_champion(self._view)
            self._view.keep_up()

    def _follow_champion(self, view: RegistryView) -> None:
        try:
            version = view.champion(self.model_name)
        except RegistryError:
            if self._champion is not None:
                return
            version = self._cache.last_champion(self.model_name)
        if version is None:
            self._champion = None
        elif not self._is_champion(version) and not self._is_refused(version):
            self._promote(view, version)

    def resolve(self, reference: ModelReference) -> ServedModel:
        """The model that a reference names.

        Raises:
            ModelNotFoundError: there is no such model.
            RegistryError: the registry is needed and does not answer.
            ModelNotReadyError: the model cannot be served.
        """
        if reference.name == PRETRAINED:
            if not reference.is_bare:
                raise _unknown(reference)
            return self._shipped_or_raise()
        if reference == ModelReference(self.model_name):
            return self.default or self._shipped_or_raise()
        champion = self._champion
        if champion is not None and reference == ModelReference(self.model_name, CHAMPION):
            return champion
        if self._view is None:
            raise _unknown(reference)
        try:
            version = self._view.look_up(reference)
        except ModelNotFoundError as error:
            raise _unknown(reference) from error
        return _serve(self._view, version, CHAMPION if reference.is_bare else reference.alias)

    def versions(self) -> Sequence[ModelVersion]:
        """Versions of the default model, newest first; those of the cache while the registry is away."""
        return [] if self._view is None else self._view.versions(self.model_name)

    def is_loaded(self, version: ModelVersion) -> bool:
        """Whether a version is in memory."""
        return self._is_champion(version) or self._cache.is_loaded(version)

    def _shipped_or_raise(self) -> ServedModel:
        if self._shipped is None:
            raise ModelNotReadyError(
                "no model is ready",
                expected=f"a champion of {self.model_name}, or a shipped model",
                got=f"none (registry: {self.registry_state})",
                remedy="train and promote a model, or ask again when the registry is back",
            )
        return self._shipped

    def _is_champion(self, version: ModelVersion) -> bool:
        current = self._champion
        return current is not None and (current.version, current.bundle.digest) == (
            version.number,
            version.digest,
        )

    def _is_refused(self, version: ModelVersion) -> bool:
        digest, until = self._refused
        return digest == version.digest and self._clock() < until

    def _promote(self, view: RegistryView, version: ModelVersion) -> None:
        name = f"{version.name}/{version.number}"
        try:
            self._champion = _serve(view, version, CHAMPION)
        except (ModelNotReadyError, RegistryError, StorageError) as error:
            self._refused = (version.digest, self._clock() + RETRY_S)
            self.observer.refused(_refusal(error))
            _LOG.warning("what is in service stays, %s cannot follow: %s", name, error)
        else:
            self.observer.reloaded()
            _LOG.info("in service: %s", name)
            self._remember(version)

    def _remember(self, version: ModelVersion) -> None:
        try:
            self._cache.remember_champion(version)
        except StorageError as error:
            _LOG.warning("the champion will not be remembered over a restart: %s", error)


def _serve(view: RegistryView, version: ModelVersion, alias: str | None) -> ServedModel:
    try:
        bundle = view.bundle(version)
    except BundleError as error:
        raise ModelNotReadyError(
            f"{version.name}/{version.number} is refused", expected="a sound bundle", got=str(error)
        ) from error
    return ServedModel(bundle, version.name, version.number, alias, version.run_id or None)


def _refusal(error: CspaceError) -> Refusal:
    if isinstance(error, RegistryError):
        return "registry"
    if isinstance(error, StorageError):
        return "storage"
    return "golden" if isinstance(error.__cause__, GoldenMismatchError) else "bundle"


def _unknown(reference: ModelReference) -> ModelNotFoundError:
    return ModelNotFoundError(
        "the model is unknown",
        expected="a model, version or alias of the registry, or pretrained",
        got=str(reference),
        remedy="GET /models lists the models",
    )
