"""A graph's bytes against what a bundle may hold, before onnxruntime sees them.

The bytes come from whoever could write to the registry. onnxruntime would read files beside the graph, load
code by other domains' operators, and compute for as long as it is told to; so what is not known here is
refused: every field, every operator, every tensor that is not whole, every loop without an end.
"""

from collections import ChainMap
from collections.abc import Mapping, MutableMapping, Sequence
from dataclasses import replace

from cspace.bundle.onnx import fields
from cspace.bundle.onnx.attributes import Attributes, constant, read_attributes
from cspace.bundle.onnx.folding import MAX_FOLDED, SMALL, UNKNOWN, Folding, Value, folded, is_absurd
from cspace.bundle.onnx.integers import (
    BOOL,
    FLOAT,
    INT64,
    is_apart,
    is_natural,
    kind_of,
    may_divide_by_minus_one,
)
from cspace.bundle.onnx.loops import MAX_COMPUTED, MAX_DEPTH, turns
from cspace.bundle.onnx.operators import DOMAINS, NEWEST_OPSET, OLDEST_OPSET, OPERATORS, STANDARD
from cspace.bundle.onnx.tensors import checked_shape, read_tensor
from cspace.bundle.onnx.wire import Budget, Message

# Bytes 4 to 8 of onnxruntime's own format, by which it tells the two apart. An ONNX file may have them, too.
_OTHER_FORMAT = b"ORTM"
MAX_NODES = 10_000


def check_graph(name: str, model: bytes) -> Folding:
    """Check a graph.

    Args:
        name: the file's, for messages.
        model: its bytes.

    Returns:
        How much it computes from constants.

    Raises:
        BundleIntegrityError: it is no ONNX graph, or more than a bundle's graph may be.
    """
    budget = Budget(name)
    if model[4:8] == _OTHER_FORMAT:
        raise budget.refuse("onnxruntime's own format", "an ONNX graph")
    try:
        whole = Message("the model", fields.MODEL, memoryview(model), budget)
        _check_opsets(whole, budget)
        walk = _Walk(budget)
        for part in whole.parts("graph"):
            walk.graph(part, {}, (), times=1, depth=0)
    except MemoryError as error:
        raise budget.refuse("more than fits into the memory", "an ONNX graph") from error
    if "graph" not in whole:
        raise budget.refuse("no graph", "an ONNX graph")
    return walk.folding


def _check_opsets(model: Message, budget: Budget) -> None:
    versions: dict[str, int] = {}
    for part in model.parts("opset_import"):
        opset = Message("an opset", fields.OPSET, part, budget)
        domain, version = opset.text("domain"), opset.number("version")
        # Graphs that were joined say the same twice.
        if domain not in DOMAINS or versions.get(domain, version) != version:
            raise budget.refuse(f"operators of {domain!r}"[:100], "ONNX's own operators, of one version")
        versions[domain] = version
    standard = [version for domain, version in versions.items() if domain in STANDARD]
    if len(standard) != 1 or not OLDEST_OPSET <= standard[0] <= NEWEST_OPSET:
        raise budget.refuse(f"opsets {standard}", f"one, {OLDEST_OPSET} to {NEWEST_OPSET}")


class _Walk:
    """One pass through a graph and those within it."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget
        self._nodes = self._computed = 0
        # Outside of loops and within.
        self._folded = [0, 0]

    @property
    def folding(self) -> Folding:
        """What the sizes of the constants come to."""
        outside, within = (elements <= MAX_FOLDED for elements in self._folded)
        if not within:
            return Folding.UNSAFE
        return Folding.QUICK if outside else Folding.TO_BE_TRIED

    def graph(
        self,
        data: memoryview,
        outer: MutableMapping[str, Value],
        fed: Sequence[Value],
        times: int,
        depth: int,
    ) -> list[Value]:
        """Check a graph.

        Args:
            data: its bytes.
            outer: what its nodes see from outside.
            fed: what is known of its inputs, those of the file's graph aside.
            times: how often it is computed in one run of the file.
            depth: how many graphs it lies within.

        Returns:
            What is known of its outputs.
        """
        if depth > MAX_DEPTH:
            raise self._budget.refuse("more", f"graphs within graphs, {MAX_DEPTH} deep")
        graph = Message("a graph", fields.GRAPH, data, self._budget)
        known = ChainMap[str, Value]({}, outer)
        inputs = graph.parts("input")
        for index, part in enumerate(inputs):
            seen = fed[index] if index < len(fed) else UNKNOWN
            name, kind = self._declared(part)
            self._define(known, name, seen if depth else Value(kind=kind))
        for part in graph.parts("initializer"):
            tensor = read_tensor(part, self._budget)
            self._define(known, tensor.name, constant(tensor))
        for part in graph.parts("value_info"):
            self._declared(part)
        nodes = graph.parts("node")
        self._count(len(nodes), times)
        for part in nodes:
            self._node(part, known, times, depth)
        outputs = [self._declared(part)[0] for part in graph.parts("output")]
        return [known.get(name, UNKNOWN) for name in outputs]

    def _count(self, nodes: int, times: int) -> None:
        self._nodes += nodes
        self._computed += times * nodes
        if self._nodes > MAX_NODES:
            raise self._budget.refuse(f"{self._nodes} nodes", f"at most {MAX_NODES}")
        if self._computed > MAX_COMPUTED:
            raise self._budget.refuse("more", f"at most {MAX_COMPUTED} nodes a run, a loop's once a turn")

    def _node(self, data: memoryview, known: MutableMapping[str, Value], times: int, depth: int) -> None:
        node = Message("a node", fields.NODE, data, self._budget)
        operator = node.text("op_type")
        if node.text("domain") not in STANDARD or operator not in OPERATORS or node.text("overload"):
            name = f"{node.text('domain')}:{operator}"[:100]
            raise self._budget.refuse(f"the operator {name!r}", "operators that compute tensors from tensors")
        places = [self._seen(name, known) for name in node.texts("input")]
        attributes = read_attributes(node, self._budget)
        if (attributes.body is None) == (operator == "Loop"):
            raise self._budget.refuse(f"a graph within {operator}, or none", "one within Loop and no other")
        if attributes.body is not None:
            found = self._loop(attributes.body, places, known, times, depth)
        else:
            inputs = [value for value in places if value is not None]
            found = [self._result(operator, inputs, attributes, depth)]
        for index, name in enumerate(node.texts("output")):
            # All parts of a Split are alike; other operators' further outputs are seldom of use.
            place = 0 if operator == "Split" else index
            if name:
                self._define(known, name, found[place] if place < len(found) else UNKNOWN)

    def _loop(
        self,
        body: memoryview,
        places: list[Value | None],
        known: MutableMapping[str, Value],
        times: int,
        depth: int,
    ) -> list[Value]:
        """What is known of a loop's outputs: their types. What is carried is what some turn made of it."""
        again = times * turns(places[0] if places else None, self._budget)
        carried = [UNKNOWN if value is None else Value(kind=value.kind) for value in places[2:]]
        fed = [Value(kind=INT64, natural=True, apart=True), Value(kind=BOOL), *carried]
        # The first output is whether it goes on.
        results = self.graph(body, known, fed, again, depth + 1)[1:]
        return [Value(kind=value.kind) for value in results]

    def _result(self, operator: str, inputs: list[Value], attributes: Attributes, depth: int) -> Value:
        """What is known of a node's first output; how much of it is computed early is added up."""
        if operator == "Constant":
            return attributes.constant or SMALL
        if is_absurd(operator, inputs):
            raise self._budget.refuse(f"an absurd size by {operator}", "tensors of at most 2^26 elements")
        if may_divide_by_minus_one(operator, inputs):
            expected = "a constant, or a number that is not negative"
            raise self._budget.refuse(f"{operator} of integers by what may be -1", expected)
        kind = kind_of(operator, inputs, attributes.numbers)
        if operator == "ConstantOfShape":
            kind = FLOAT if attributes.constant is None else attributes.constant.kind
        natural = is_natural(operator, inputs, kind)
        if operator in ("Shape", "Size"):
            result = SMALL
        elif all(value.constant for value in inputs):
            result = folded(operator, inputs)
            self._folded[depth > 0] += MAX_FOLDED + 1 if result.size is None else result.size
        else:
            result = UNKNOWN
        apart = natural or is_apart(operator, inputs, kind)
        return replace(result, kind=kind, natural=natural, apart=apart)

    def _seen(self, name: str, known: Mapping[str, Value]) -> Value | None:
        if not name:
            return None
        if name not in known:
            raise self._budget.refuse(
                f"{name[:100]!r} before it is known", "nodes in the order of their values"
            )
        return known[name]

    def _define(self, known: MutableMapping[str, Value], name: str, value: Value) -> None:
        if name in known or not name:
            raise self._budget.refuse(f"{name[:100]!r} twice", "a name of its own for every value")
        known[name] = value

    def _declared(self, data: memoryview) -> tuple[str, int | None]:
        """Name and type of an input, an output or what lies between; a tensor of a size that can be."""
        entry = Message("a value", fields.VALUE, data, self._budget)
        kind = None
        for part in entry.parts("type"):
            whole = Message("a type", fields.TYPE, part, self._budget)
            for tensor in whole.parts("tensor_type"):
                found = Message("a tensor's type", fields.TENSOR_TYPE, tensor, self._budget)
                kind = found.number("elem_type")
                for shape in found.parts("shape"):
                    checked_shape(self._sizes(shape), self._budget)
        return entry.text("name"), kind

    def _sizes(self, data: memoryview) -> list[int]:
        shape = Message("a shape", fields.SHAPE, data, self._budget)
        axes = (Message("a size", fields.DIMENSION, part, self._budget) for part in shape.parts("dim"))
        return [axis.number("dim_value", 1) for axis in axes]
