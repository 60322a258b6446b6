"""Whether samples can be asked for."""

from inference_api.failures import ModelNotReadyError
from inference_api.models.served import ServedModel
from inference_api.models.store import ModelStore
from inference_api.turns.turns import STUCK_S, Turns
from services.registry.references import ModelReference


def default_model(store: ModelStore, turns: Turns) -> ServedModel:
    """The model that answers requests that name none.

    Raises:
        StartingError: the search of plans is not loaded yet.
        ModelNotReadyError: there is none, or no request comes to its end.
    """
    if store.planner.state == "loading":
        store.planner.require()
    served = store.resolve_now(ModelReference(store.model_name))
    if served is None or turns.are_stuck:
        raise ModelNotReadyError(
            "samples cannot be asked for",
            expected=f"a model, and requests that are computed within {STUCK_S:g} s",
            got="no model" if served is None else "requests that do not end",
            remedy="ask again in some seconds; if that does not help, start the server anew",
        )
    return served
