"""Plans whose end is known, on pictures that no training has seen, as evidence for the gate."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cspace.bundle import Bundle
from services.evaluator.evaluation.gate import Comparison, Gain
from services.evaluator.evaluation.rivals import Rival
from services.evaluator.evaluation.shadow import FEWEST_OUTCOMES, LEAST, gain_in_words
from services.evaluator.statistics import Interval, log_losses, mean_interval
from services.outcomes import KnownPlan, known_plans
from services.registry.ports import Tracking


@dataclass(frozen=True, slots=True)
class HeldOutEvidence:
    """What a version and the champion say of configurations that plans have shown to be free or not.

    Args:
        champion: its version number.
        plans: on pictures that are held out.
        losses: mean log loss of the version and of the champion; None for fewer than 20.
        gain: mean over plans of the champion's log loss less that of the version; likewise.
    """

    champion: int | None
    plans: int
    losses: tuple[float, float] | None = None
    gain: Interval | None = None

    def beside(self, comparison: Comparison) -> Comparison:
        """The comparison with the champion, in which this counts as a measure if it is known."""
        if self.losses is None or self.gain is None:
            return comparison
        measure = Gain("log loss of held-out plans", *self.losses, self.gain)
        return replace(comparison, gains=(*comparison.gains, measure))

    def __str__(self) -> str:
        if self.gain is None:
            return f"{self.plans} held-out plans with an outcome; {FEWEST_OUTCOMES} would count"
        return (
            f"beside version {self.champion}, predicts {self.plans} held-out plans {gain_in_words(self.gain)}"
        )


def outcome_evidence(
    bundle: Bundle, champion: Rival, tracking: Tracking, rng: np.random.Generator
) -> HeldOutEvidence | None:
    """From all plans that were kept; None without any on a picture that is held out, or without heads.

    Args:
        bundle: of the version.
        champion: it is compared with.
        tracking: where outcomes were uploaded.
        rng: of the interval.

    Raises:
        RegistryError: the tracking server is away or refuses.
    """
    beside = champion.packed.load()
    if not (bundle.has_validity and beside.has_validity):
        return None
    plans = [one for one in known_plans(tracking, bundle.robot) if one.held_out]
    if not plans:
        return None
    if len(plans) < FEWEST_OUTCOMES:
        return HeldOutEvidence(champion.version, len(plans))
    ours, theirs = (_losses(one, plans) for one in (bundle, beside))
    means = float(ours.mean()), float(theirs.mean())
    return HeldOutEvidence(champion.version, len(plans), means, mean_interval(theirs - ours, rng))


def _losses(bundle: Bundle, plans: list[KnownPlan]) -> NDArray[np.float64]:
    """Mean log loss of each plan's configurations, (n,)."""
    losses = []
    for plan in plans:
        free, collision = plan.labelled(bundle.spec.world.space)
        picture = bundle.prepare(bundle.spec.world.read_picture(plan.image))
        confidence = bundle.score(picture, np.concatenate([free, collision]))
        losses.append(log_losses(confidence, np.arange(len(confidence)) < len(free), LEAST).mean())
    return np.array(losses, dtype=np.float64)
