"""What an evaluation is asked for: which version, how much, and whether it may promote."""

from dataclasses import dataclass, replace
from pathlib import Path

from cspace.errors import ConfigError
from services.evaluator.evaluation.budget import BUDGETS, Budget
from services.registry.references import ModelReference

MAX_SEED = 2**63 - 1


@dataclass(frozen=True, slots=True)
class Request:
    """One evaluation.

    Args:
        model: the version under test.
        budget: how much is evaluated.
        seed: of scenarios, samples and problems.
        promote: whether the decision is recorded and the alias moved.
        data: a data set whose held-out scenes it is judged on; None for those of the version's own data.
        shipped: folder of the shipped model, which the version is compared with; None leaves that out.
    """

    model: ModelReference
    budget: Budget
    seed: int = 0
    promote: bool = True
    data: Path | None = None
    shipped: Path | None = None


def make_request(
    model: str,
    *,
    budget: str = "quick",
    scenarios: int | None = None,
    seed: int = 0,
    promote: bool = True,
    data: Path | None = None,
    shipped: Path | None = None,
) -> Request:
    """A request from texts and numbers of the command line.

    Args:
        model: ``name@alias`` or ``name/version``.
        budget: ``quick`` or ``full``.
        scenarios: per split, instead of the budget's.
        seed: 0 to 2^63 - 1.
        promote: see :class:`Request`.
        data: likewise.
        shipped: likewise.

    Raises:
        ConfigError: a value is out of range.
    """
    if budget not in BUDGETS:
        raise ConfigError("the budget is unknown", expected=" or ".join(BUDGETS), got=repr(budget))
    if not 0 <= seed <= MAX_SEED:
        raise ConfigError("the seed is out of range", expected=f"0 to {MAX_SEED}", got=str(seed))
    if scenarios is not None and scenarios < 1:
        raise ConfigError("there are too few scenarios", expected="at least 1", got=str(scenarios))
    chosen = BUDGETS[budget]
    if scenarios is not None:
        chosen = replace(chosen, scenarios=scenarios)
    reference = ModelReference.parse_version(model, "the model reference is unknown")
    return Request(reference, chosen, seed, promote, data, shipped)
