"""What servers found of a version beside the champion, on real requests: see ``inference_api.shadow``."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cspace.bundle.spec import PLAN_CONFIDENCE
from services.evaluator.evaluation.gate import Verdict
from services.evaluator.statistics import Interval, log_losses, mean_interval
from services.names import SHADOW
from services.outcomes import uploaded
from services.registry.ports import ModelVersion, Tracking

FEWEST_OUTCOMES = 20
LEAST = 1e-3
"""Probability that predictions are taken to give to anything."""


@dataclass(frozen=True, slots=True)
class ShadowEvidence:
    """Predictions of a version and of the champion for the same plans.

    Args:
        champion: its version number.
        plans: that were compared.
        agreement: share of them that both or neither would release at the default confidence of plans.
        outcomes: of these plans, of which it is known whether they collided.
        gain: log loss of the champion less that of the version on those; None for fewer than 20.
    """

    champion: int
    plans: int
    agreement: float
    outcomes: int
    gain: Interval | None

    def __str__(self) -> str:
        found = (
            f"as shadow: agrees with version {self.champion} on {self.agreement:.1%} of {self.plans} plans"
        )
        if self.gain is None:
            return f"{found}, {self.outcomes} with an outcome; {FEWEST_OUTCOMES} would count"
        return f"{found}; predicts {self.outcomes} outcomes {gain_in_words(self.gain)}"


def shadow_evidence(
    version: ModelVersion, champion: int | None, tracking: Tracking, rng: np.random.Generator
) -> ShadowEvidence | None:
    """From all uploaded outcomes; None where no server compared the version with the present champion."""
    beside = f"{version.name}/{champion}"
    compared: dict[tuple[Any, Any], dict[str, Any]] = {}
    collided: dict[tuple[Any, Any], bool] = {}
    for _, _, rows in uploaded(tracking):
        for row in rows:
            key = row.get("client"), row["request_id"]
            if (row["kind"], row["model"], row.get("beside")) == (SHADOW, str(version), beside):
                compared[key] = row
            elif (row["kind"], row["model"]) == ("plan", beside) and row.get("collided") is not None:
                collided[key] = row["collided"]
    if champion is None or not compared:
        return None
    stated = np.array([(one["confidence"], one["confidence_beside"]) for one in compared.values()])
    released = stated >= PLAN_CONFIDENCE
    known = np.array([key in collided for key in compared])
    free = ~np.array([collided[key] for key in compared if key in collided], dtype=np.bool_)
    losses = log_losses(stated[known], free[:, None], LEAST)
    gain = mean_interval(losses[:, 1] - losses[:, 0], rng) if len(free) >= FEWEST_OUTCOMES else None
    agreement = float(np.mean(released[:, 0] == released[:, 1]))
    return ShadowEvidence(champion, len(stated), agreement, len(free), gain)


def gain_in_words(gain: Interval) -> str:
    """Whether a gain in log loss is one, and its size."""
    words = "better" if gain.low > 0.0 else "worse" if gain.high < 0.0 else "no different"
    return f"{words} beyond the interval: gain in log loss {gain:+.3f}"


def with_evidence(verdict: Verdict, evidence: ShadowEvidence | None) -> Verdict:
    """A verdict that also counts outcomes: what predicts them worse than the champion is not promoted."""
    if evidence is None:
        return verdict
    is_worse = evidence.gain is not None and evidence.gain.high < 0.0
    reasons = (*verdict.reasons, str(evidence))
    return replace(verdict, promoted=verdict.promoted and not is_worse, reasons=reasons)
