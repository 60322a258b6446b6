"""How long a loop may run: its turns stand in the graph, and what all loops together compute is bounded.

The search for ways spreads costs over a grid by a Loop of 64 turns that stops earlier where it can. A number
of turns that is computed, or that is absent, could be any number, and is refused.
"""

from cspace.bundle.onnx.folding import Value
from cspace.bundle.onnx.wire import Budget

MAX_TURNS = 10_000
# Nodes that one run may compute, those of a loop's body once for every turn.
MAX_COMPUTED = 1_000_000
# Graphs within graphs.
MAX_DEPTH = 4


def turns(trips: Value | None, budget: Budget) -> int:
    """Turns that a loop takes at most.

    Args:
        trips: the loop's first input; None where it is left out.
        budget: of the file.

    Raises:
        BundleIntegrityError: nobody can tell, or too many.
    """
    values = None if trips is None else trips.values
    if values is None or len(values) != 1 or values[0] > MAX_TURNS:
        got = "any number" if values is None else str(list(values))[:100]
        raise budget.refuse(f"a Loop of {got} turns", f"at most {MAX_TURNS}, as a constant of the graph")
    return max(values[0], 0)
