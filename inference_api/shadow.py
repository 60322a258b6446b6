"""A challenger beside the champion: what the version of the alias ``shadow`` predicts for its plans.

A share of the plans, which a tag of the version states, is scored once more when the caller has its answer:
one at a time, and only while no request waits. Each comparison is a row among the outcomes, where the
evaluator finds it.
"""

import asyncio
import logging
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.requests import ClientDisconnect

from cspace.errors import CspaceError
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.scheduler import Job, Lookups, Scheduler
from services.names import SHADOW
from services.outcomes import Spool

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """A plan of a champion.

    Args:
        request_id: of the request.
        client: name of the client's key; None without keys.
        served: the champion.
        image: the picture as it was sent.
        path: (k, d) rad.
        confidence: the champion's, without a site's calibration.
    """

    request_id: str
    client: str | None
    served: ServedModel
    image: bytes
    path: NDArray[np.float64]
    confidence: float


class _BusyError(Exception):
    """A request waits."""


class Shadow:
    """Compares plans in the background; for one event loop.

    Args:
        store: of the models.
        scheduler: in whose turns requests are computed.
        lookups: where the challenger is looked up.
        spool: of outcomes; without one nothing is compared.
        count: called with what became of each: ``compared``, ``dropped`` or ``failed``.
    """

    def __init__(
        self,
        store: ModelStore,
        scheduler: Scheduler,
        lookups: Lookups,
        spool: Spool | None,
        count: Callable[[str], None],
    ) -> None:
        self._store, self._scheduler, self._lookups = store, scheduler, lookups
        self._spool, self._count = spool, count
        self._task: asyncio.Task[None] | None = None

    def take(self, offer: Offer) -> None:
        """Compare a plan unless another is being compared; waits for nothing."""
        if self._spool is not None and (self._task is None or self._task.done()):
            self._task = asyncio.get_running_loop().create_task(self._compare(self._spool, offer))

    async def _compare(self, spool: Spool, offer: Offer) -> None:
        try:
            found = await self._lookups.run(partial(self._store.shadow, offer.served), SHADOW)
            if found is None or random.random() >= found[1]:  # noqa: S311 - a share, no secret
                return
            row = await self._scheduler.run(partial(self._row, offer, found[0]), SHADOW)
        except (_BusyError, ClientDisconnect):
            self._count("dropped")
        except CspaceError as error:
            _LOG.warning("a plan is not compared with the shadow's: %s", error.what)
            self._count("failed")
        else:
            spool.add([row])
            self._count("compared")

    def _row(self, offer: Offer, challenger: ServedModel, job: Job) -> dict[str, Any]:
        def check_cancelled() -> None:
            if self._scheduler.anybody_waits:
                raise _BusyError
            job.check_cancelled()

        check_cancelled()
        bundle = challenger.bundle
        picture = self._store.pictures.get(bundle, offer.image, check_cancelled=check_cancelled).picture
        confidence = bundle.path_confidence(picture, offer.path, check_cancelled)
        return {
            "kind": SHADOW,
            "request_id": offer.request_id,
            "client": offer.client,
            "received_s": round(time.time(), 3),
            "model": str(challenger),
            "beside": str(offer.served),
            "confidence": confidence,
            "confidence_beside": offer.confidence,
        }
