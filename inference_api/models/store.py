"""Which bundle answers which reference: the champion in service, others on demand, the shipped one else.

The champion is looked up in the background (:meth:`ModelStore.refresh`), so that a promotion is served
without a restart and no request waits for the registry. A champion that is refused, or a registry that is
away, leaves the one in service. With no champion at all the shipped bundle answers if it is of the same
robot, and the answer says so.
"""

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

from cspace.bundle import Bundle
from cspace.errors import BundleError, ModelNotFoundError, RegistryError, StorageError
from inference_api.failures import ModelNotReadyError
from inference_api.models.apart.processes.child import Child
from inference_api.models.bundle_cache import BundleCache, NotLoadedYetError
from inference_api.models.pictures import PictureCache
from inference_api.models.planner import PlannerStart
from inference_api.models.registry_view import LOAD_WAIT_S, RegistryView
from inference_api.models.served import ServedModel
from inference_api.models.shipped import ShippedModels
from inference_api.models.succession import Fetch, Succession, refusal_of
from inference_api.telemetry.observer import Observer
from services.names import ALIAS_CHAMPION, TAG_ROBOT
from services.registry.models.port import ModelLookups, ModelVersion
from services.registry.references import PRETRAINED, ModelReference
from services.registry.scrubbing import anonymous

_LOG = logging.getLogger(__name__)


class ModelStore:
    """Bundles by reference; safe to share between threads.

    Args:
        registry: None serves the shipped model only.
        cache: of downloaded bundles.
        shipped: what comes with the server.
        model_name: whose champion is the default.
        lookup_s: how long a looked-up version or alias is trusted.
        clock: seconds, monotonic.
        pictures: those that were encoded already; none are kept when None.
        wait_s: how long :meth:`resolve` waits for a bundle, at most.
        children: that look up and download; they start and end with the store.
    """

    def __init__(
        self,
        registry: ModelLookups | None,
        cache: BundleCache,
        shipped: ShippedModels,
        model_name: str,
        lookup_s: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
        pictures: PictureCache | None = None,
        wait_s: float = LOAD_WAIT_S,
        children: Sequence[Child] = (),
    ) -> None:
        self.observer = Observer()
        self.planner = PlannerStart()
        self.pictures = PictureCache(0) if pictures is None else pictures
        self.model_name = model_name
        self._cache = cache
        self._view = None if registry is None else RegistryView(registry, cache, lookup_s, clock)
        self.shipped = shipped
        self._champion: ServedModel | None = None
        # Of the last champion; None where it is not known.
        last = cache.disk.last_champion(model_name)
        self._robot = None if last is None else last.tags.get(TAG_ROBOT)
        self._stand_in: ServedModel | None = None
        self._succession = Succession(cache, self._succeeded, self._failed, clock)
        self._wait_s, self._children = wait_s, tuple(children)

    @property
    def registry_state(self) -> Literal["none", "reachable", "unreachable"]:
        """Whether the registry answered when it was asked last."""
        if self._view is None:
            return "none"
        return "unreachable" if self._view.is_away else "reachable"

    @property
    def successor(self) -> Literal["none", "pending", "refused"]:
        """Whether there is a champion that is not in service: it is being fetched, or could not follow."""
        return self._succession.state

    @property
    def default(self) -> ServedModel | None:
        """The model that answers requests that name none, None without one."""
        found = self._champion or self._stand_in
        return found if found is None else self._as_confirmed(found)

    def load_shipped(self) -> None:
        """Load what is shipped; without a usable bundle the reason is logged and the store goes on."""
        self.shipped.look()
        self._choose_stand_in()

    def start(self) -> None:
        """Start the children that are needed at once, without waiting for them."""
        # Where the last champion is on disk, nothing has to be downloaded yet.
        has_champion = self._cache.disk.last_champion(self.model_name) is not None
        for child in self._children[: 1 if has_champion else 2]:
            child.start()

    def close(self) -> None:
        """End the children: whoever waits for them gets an error at once."""
        for child in self._children:
            child.close()

    def refresh(self, wait_s: float = LOAD_WAIT_S) -> None:
        """Look up the champion and what requests named lately; the project's errors are not raised.

        Args:
            wait_s: for what has to be loaded, at most; it comes into service when it is there, waited for
                or not.
        """
        for child in self._children:
            child.tend()
        if self._view is not None:
            until_s = time.monotonic() + wait_s
            fetch = self._follow_champion(self._view)
            self._view.keep_up(wait_s)
            if fetch is not None:
                self._succession.wait_for(fetch, max(0.0, until_s - time.monotonic()))

    def _follow_champion(self, view: RegistryView) -> Fetch | None:
        try:
            version = view.champion(self.model_name)
        except RegistryError:
            if self._champion is not None:
                return None
            version = self._cache.disk.last_champion(self.model_name)
        if version is None or self._is_champion(version):
            if version is None:
                self._champion = None
            self._succession.none()
            return None
        return self._succession.fetch(version)

    def resolve_now(self, reference: ModelReference) -> ServedModel | None:
        """The model that a reference names, from memory alone; None when :meth:`resolve` has to be asked.

        Raises:
            ModelNotFoundError: there is no such model, or there was none a moment ago.
            ModelNotReadyError: no model answers by default.
        """
        if reference.name in self.shipped:
            if not reference.is_bare:
                raise _unknown(reference)
            if not self.shipped.is_usable(reference.name):
                raise self._not_ready()
            return self.shipped.peek(reference.name)
        if reference == ModelReference(self.model_name):
            return self._or_raise(self.default)
        champion = self._champion
        if champion is not None and reference == ModelReference(self.model_name, ALIAS_CHAMPION):
            return self._as_confirmed(champion)
        if self._view is None:
            return self.shipped.peek(self._instead_of(reference), fallback=True)
        try:
            version = self._view.recall(reference)
        except ModelNotFoundError:
            return self.shipped.peek(self._instead_of(reference), fallback=True)
        bundle = None if version is None else self._cache.peek(version)
        return None if version is None or bundle is None else self._found(bundle, version, reference)

    def resolve(self, reference: ModelReference) -> ServedModel:
        """The model that a reference names; may ask the registry and wait for a bundle.

        Raises:
            ModelNotFoundError: there is no such model.
            RegistryError: the registry is needed and does not answer.
            StorageError: the cache cannot be written.
            ModelNotReadyError: the model cannot be served, or is still being fetched.
        """
        found = self.resolve_now(reference)
        if found is not None:
            return found
        if reference.name in self.shipped:
            return self.shipped.get(reference.name)
        view, until_s = self._view, time.monotonic() + self._wait_s
        if view is None:
            return self.shipped.get(self._instead_of(reference), fallback=True)
        try:
            version = view.look_up(reference)
        except ModelNotFoundError:
            return self.shipped.get(self._instead_of(reference), fallback=True)
        try:
            bundle = self._cache.get(version, max(0.0, until_s - time.monotonic()))
        except NotLoadedYetError as error:
            raise ModelNotReadyError(error.what, remedy=error.remedy) from None
        except BundleError as error:
            raise ModelNotReadyError(
                f"{version} is refused", expected="a sound bundle", got=anonymous(str(error))
            ) from error
        return self._found(bundle, version, reference)

    def versions(self, name: str) -> Sequence[ModelVersion]:
        """Versions of a model, newest first; those of the cache while the registry is away."""
        return [] if self._view is None else self._view.versions(name)

    def loaded(self, version: ModelVersion) -> Bundle | None:
        """A version's bundle if it is in memory; looking at it is no use of it."""
        champion = self._champion
        is_champion = champion is not None and self._is_champion(version)
        return champion.bundle if champion and is_champion else self._cache.peek(version, use=False)

    def _found(self, bundle: Bundle, version: ModelVersion, reference: ModelReference) -> ServedModel:
        confirmed = self._view is None or self._view.confirms(reference, version)
        return ServedModel.of(bundle, version, _alias(reference), confirmed=confirmed)

    def _as_confirmed(self, served: ServedModel) -> ServedModel:
        """The champion or what stands in for it, and whether the registry says that it is that."""
        is_away = self._view is not None and self._view.is_away
        return replace(served, confirmed=False) if is_away or self.successor != "none" else served

    def _choose_stand_in(self) -> None:
        """A shipped model stands in for champions of its own robot."""
        self._stand_in = self.shipped.stand_in(self.model_name, self._robot)

    def _instead_of(self, reference: ModelReference) -> str:
        """The shipped model of the robot of a model that has no champion.

        Raises:
            ModelNotFoundError: there is none.
        """
        name = self.shipped.named_after(reference.name) if reference.is_bare else None
        if name is None:
            raise _unknown(reference)
        return name

    def _or_raise(self, served: ServedModel | None) -> ServedModel:
        if served is None:
            raise self._not_ready()
        return served

    def _not_ready(self) -> ModelNotReadyError:
        other = "; the shipped model is of another robot" if self.shipped.is_usable(PRETRAINED) else ""
        return ModelNotReadyError(
            "no model is ready",
            expected=f"a champion of {self.model_name}, or a shipped model",
            got=f"none (registry: {self.registry_state}){other}",
            remedy="train and promote a model, or ask again when the registry is back",
        )

    def _is_champion(self, version: ModelVersion) -> bool:
        current = self._champion
        return current is not None and (current.version, current.bundle.digest) == (
            version.number,
            version.digest,
        )

    def _succeeded(self, version: ModelVersion, bundle: Bundle) -> None:
        self._champion, self._robot = ServedModel.of(bundle, version, ALIAS_CHAMPION), bundle.robot
        self._choose_stand_in()
        self.observer.reloaded()
        _LOG.info("in service: %s/%d", version.name, version.number)
        try:
            self._cache.disk.remember_champion(version)
        except StorageError as error:
            _LOG.warning("the champion will not be remembered over a restart: %s", error)

    def _failed(self, version: ModelVersion, error: BaseException) -> None:
        self.observer.refused(refusal_of(error))
        _LOG.warning(
            "what is in service stays, %s/%d cannot follow: %s",
            version.name,
            version.number,
            anonymous(str(error)),
        )


def _alias(reference: ModelReference) -> str | None:
    return ALIAS_CHAMPION if reference.is_bare else reference.alias


def _unknown(reference: ModelReference) -> ModelNotFoundError:
    return ModelNotFoundError(
        "the model is unknown",
        expected="a model, version or alias of the registry, or pretrained",
        got=str(reference),
        remedy="GET /models lists the models",
    )
