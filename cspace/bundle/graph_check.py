"""Checks a bundle's ONNX graphs before onnxruntime opens them.

The bytes come from whoever may write to the registry. A graph passes if it is whole, uses operators of ONNX's
standard set that compute tensors from tensors, and has a size for every tensor that follows from the sizes of
its inputs. The sizes bound the memory of a run before there is one; nothing is computed here. Shapes are
inferred one node at a time, so that no node is looked at before the sizes of its inputs are known to be small
enough. ``onnx`` follows the values of sizes through a few small nodes only: it writes out a dimension for
each element of every one-dimensional tensor that it meets on the way.

``onnx`` takes about a second to import, so servers check bundles in a process of their own
(:mod:`cspace.bundle.verification`) and never import this module.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import checker, helper, numpy_helper, shape_inference

from cspace.bundle.files import (
    BELIEF_FILE,
    ENCODER_FILE,
    GENERATOR_FILE,
    MAP_FILE,
    NOVELTY_FILE,
    VALIDITY_FILE,
)
from cspace.bundle.runtime import CHUNK_ROWS, PATH_CHUNK_ROWS, PLACES_CHUNK_ROWS
from cspace.bundle.sampling import CACHED_ROWS
from cspace.bundle.spec import MAP, PICTURE, BundleSpec
from cspace.errors import BundleIntegrityError

# Of the tensors that a run holds at one time; the shipped models need up to 30 MiB.
MAX_RUN_BYTES = 256 * 2**20
# Of one tensor, and of a graph.
MAX_ELEMENTS, MAX_RANK, MAX_NODES = 2**26, 8, 10_000
OLDEST_OPSET, NEWEST_OPSET = 11, 26
# Local functions of the project are inlined; the name of their domain stays among the imports.
DOMAINS = ("", "ai.onnx", "cspace")

# What the project's exporters write, and what a network of one's own may need. Left out are operators that
# draw at random, make anything but tensors of numbers, run another graph, step through sequences or quantise.
_WRITTEN = """
Abs Add ArgMax Atan AveragePool Cast CastLike Ceil Clip Concat Constant Conv Cos CumSum DepthToSpace Div
Equal Erf Exp Expand Flatten Floor Gather GatherElements GatherND Gemm GlobalAveragePool Greater Identity
IsNaN LeakyRelu Less LessOrEqual Log MatMul Max MaxPool Min Mod Mul Neg NonZero Not Pow Range ReduceMax
ReduceMean ReduceMin ReduceSum Relu Reshape Resize Round ScatterElements Shape Sigmoid Sin Size Slice
Softmax Split Sqrt Squeeze Sub Sum Tanh TopK Transpose Unsqueeze Where
"""
_MORE = """
Acos Acosh And ArgMin Asin Asinh Atanh BatchNormalization Celu Compress ConstantOfShape ConvTranspose Cosh
Dropout Einsum Elu EyeLike Gelu GlobalLpPool GlobalMaxPool GreaterOrEqual GridSample GroupNormalization
HardSigmoid HardSwish Hardmax InstanceNormalization IsInf LRN LayerNormalization LogSoftmax
LpNormalization LpPool Mean MeanVarianceNormalization Mish OneHot Or PRelu Pad RMSNormalization Reciprocal
ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceProd ReduceSumSquare ScatterND Selu Sign Sinh
Softplus Softsign SpaceToDepth Swish Tan ThresholdedRelu Tile Trilu Xor
"""
OPERATORS = frozenset(f"{_WRITTEN} {_MORE}".split())
# A size of their output that depends on data is at most the number of elements of their first input.
_NO_LARGER = frozenset({"Compress", "Flatten", "NonZero", "Reshape", "Slice", "Squeeze", "TopK"})
_KINDS = frozenset(range(1, 14)) - {8}
_INTEGERS = frozenset({2, 3, 4, 5, 6, 7, 12, 13})
_ATTRIBUTES = frozenset({1, 2, 3, 4, 6, 7, 8})
# What operators and shape inference divide by.
_DIVISORS = frozenset(
    {"blocksize", "dilations", "group", "kernel_shape", "num_groups", "num_outputs", "size", "strides"}
)
_LARGEST_DIVISOR = 2**16
# Through these, ``onnx`` follows the values of sizes.
_SIZING = frozenset(
    {"Add", "Cast", "Concat", "Gather", "Mul", "Shape", "Size", "Slice", "Squeeze", "Sub", "Unsqueeze"}
)
# Elements of a tensor that sizes are computed from, and nodes that compute sizes, counted once for each node
# that takes these; the shipped models have up to 15 a graph.
_SMALL, _MAX_SIZING = 64, 10_000

Shape = tuple[int, ...]


def check_graphs(spec: BundleSpec, contents: Mapping[str, bytes]) -> None:
    """Check all graphs of a bundle at the largest sizes that a run may have.

    Args:
        spec: the description, which tells the sizes of the inputs.
        contents: file name to bytes.

    Raises:
        BundleIntegrityError: a file is no ONNX graph, or more than a bundle's graph may be.
    """
    picture = spec.world.sensor.picture_shape
    image = spec.world.sensor.to_network(np.zeros((1, *picture), dtype=np.uint8)).shape
    shapes: dict[str, Shape] = {PICTURE: image, "mu": (1, spec.latent_dim)}
    if MAP_FILE in contents:
        shapes |= {MAP: check_graph(MAP_FILE, contents[MAP_FILE], shapes).get("map", ())}
    rows = PATH_CHUNK_ROWS if spec.kind == "path" else CHUNK_ROWS
    noise = {item.name: (rows, *item.shape) for item in spec.random_inputs}
    ends = dict.fromkeys(spec.endpoints, (rows, spec.dim))
    inputs = {
        ENCODER_FILE: shapes,
        NOVELTY_FILE: shapes,
        GENERATOR_FILE: {**shapes, "latent": (rows, spec.latent_dim), **noise, **ends},
    }
    for name, sizes in inputs.items():
        if name in contents:
            check_graph(name, contents[name], sizes)
    if VALIDITY_FILE in contents:
        data, few = contents[VALIDITY_FILE], (CACHED_ROWS, spec.dim)
        found = check_graph(VALIDITY_FILE, data, {**shapes, "configurations": few})
        if "unseen" not in found:
            check_graph(VALIDITY_FILE, data, {**shapes, "configurations": (CHUNK_ROWS, spec.dim)})
    if BELIEF_FILE in contents:
        check_graph(BELIEF_FILE, contents[BELIEF_FILE], {**shapes, "places": (PLACES_CHUNK_ROWS, 3)})


def check_graph(name: str, data: bytes, shapes: Mapping[str, Shape]) -> dict[str, Shape]:
    """Check one graph.

    Args:
        name: the file's, for messages.
        data: its bytes.
        shapes: input name to the largest shape that is fed; inputs beyond these are refused.

    Returns:
        Output name to shape.

    Raises:
        BundleIntegrityError: it is no ONNX graph, or more than a bundle's graph may be.
    """
    try:
        return _Check(name, _parsed(name, data)).run(shapes)
    except (checker.ValidationError, shape_inference.InferenceError, ValueError, TypeError) as error:
        raise _refusal(
            name, str(error).splitlines()[0][:300] if str(error) else type(error).__name__
        ) from error


def _parsed(name: str, data: bytes) -> onnx.ModelProto:
    try:
        model = onnx.load_from_string(data)
    except (DecodeError, ValueError, RecursionError) as error:
        raise _refusal(name, "bytes that are no ONNX graph") from error
    whole = model.ByteSize()
    model.DiscardUnknownFields()
    if model.ByteSize() != whole:
        raise _refusal(name, "fields that ONNX does not know")
    if not model.HasField("graph") or model.functions or model.training_info:
        raise _refusal(name, "functions, training or no graph", "one graph and no more")
    versions = {(one.domain, one.version) for one in model.opset_import}
    standard = [version for domain, version in versions if domain in DOMAINS[:2]]
    if not {domain for domain, _ in versions} <= set(DOMAINS) or len(standard) != 1:
        raise _refusal(name, f"operators of {sorted(versions)}"[:200], "ONNX's own operators, of one version")
    if not OLDEST_OPSET <= standard[0] <= NEWEST_OPSET:
        raise _refusal(name, f"opset {standard[0]}", f"{OLDEST_OPSET} to {NEWEST_OPSET}")
    return model


@dataclass(slots=True)
class _Check:
    """One graph on its way through the checks.

    Args:
        name: the file's.
        model: parsed; large constants are taken out of it once they are checked.
        kinds: value to its type by ONNX's number.
        sizes: value to its shape, where a size that depends on data is a name.
        bounds: that name to the largest size.
        weights: names of constants.
        tensors: small constants by name.
        makers: output to the index of its node, where ``onnx`` may follow values through that.
        followed: nodes through which values were followed, each time.
    """

    name: str
    model: onnx.ModelProto
    kinds: dict[str, int] = field(default_factory=dict)
    sizes: dict[str, tuple[int | str, ...]] = field(default_factory=dict)
    bounds: dict[str, int] = field(default_factory=dict)
    weights: set[str] = field(default_factory=set)
    tensors: dict[str, onnx.TensorProto] = field(default_factory=dict)
    makers: dict[str, int] = field(default_factory=dict)
    followed: int = 0

    def run(self, shapes: Mapping[str, Shape]) -> dict[str, Shape]:
        graph = self.model.graph
        self._check_parts(graph)
        self._take_constants(graph)
        for value in graph.input:
            if value.name not in self.weights:
                self._feed(value, shapes)
        checker.check_model(self.model)
        nodes = [node for node in graph.node if node.op_type != "Constant"]
        for index, node in enumerate(nodes):
            self._infer(node, nodes)
            self._bound(node)
            self._check_division(node)
            if self._is_followed(node):
                self.makers[node.output[0]] = index
        for value in graph.output:
            if self.kinds.get(value.name) != value.type.tensor_type.elem_type:
                raise self._refuse(
                    f"an output {value.name[:100]!r} of another type", "the type that is computed"
                )
        self._check_memory(graph, nodes)
        return {value.name: tuple(map(self._size, self.sizes[value.name])) for value in graph.output}

    def _check_parts(self, graph: onnx.GraphProto) -> None:
        if graph.sparse_initializer or graph.quantization_annotation or len(graph.node) > MAX_NODES:
            raise self._refuse(
                f"{len(graph.node)} nodes, sparse or quantised tensors", f"at most {MAX_NODES} nodes"
            )
        for node in graph.node:
            if node.domain not in DOMAINS[:2] or node.op_type not in OPERATORS or node.overload:
                operator = f"the operator {node.domain}:{node.op_type}"[:100]
                raise self._refuse(operator, "operators that compute tensors from tensors")
            for attribute in node.attribute:
                if attribute.type not in _ATTRIBUTES or attribute.ref_attr_name:
                    raise self._refuse(
                        f"an attribute {attribute.name[:100]!r} of another kind", "numbers or texts"
                    )
                values = max(len(attribute.ints), len(attribute.floats), len(attribute.s))
                if values > _SMALL and node.op_type != "Constant":
                    got = f"an attribute {attribute.name[:100]!r} of {values} values"
                    raise self._refuse(got, f"at most {_SMALL}")
                numbers = attribute.ints or [attribute.i]
                if attribute.name in _DIVISORS and not all(1 <= one <= _LARGEST_DIVISOR for one in numbers):
                    got = f"{attribute.name} = {list(numbers)}"[:100]
                    raise self._refuse(got, f"{attribute.name} of 1 to {_LARGEST_DIVISOR}")
                if attribute.HasField("t"):
                    self._check_tensor(attribute.t)
        for tensor in graph.initializer:
            self._check_tensor(tensor)

    def _check_tensor(self, tensor: onnx.TensorProto) -> None:
        if tensor.data_location or tensor.external_data:
            raise self._refuse("a tensor that keeps its weights outside the bundle", "a graph that is whole")
        if tensor.data_type not in _KINDS or tensor.HasField("segment") or tensor.string_data:
            raise self._refuse(f"a tensor of type {tensor.data_type}", "numbers")
        self._require_size("a constant", tuple(tensor.dims))
        count = math.prod(tensor.dims)
        if tensor.HasField("raw_data") and len(tensor.raw_data) != count * _itemsize(tensor.data_type):
            raise self._refuse(
                f"a tensor of shape {list(tensor.dims)} with other data", "values as many as it says"
            )

    def _take_constants(self, graph: onnx.GraphProto) -> None:
        """Replace large initializers by inputs of their shapes, which the checker then does not copy."""
        made = [_constant(node) for node in graph.node if node.op_type == "Constant"]
        for tensor in made:
            self._check_tensor(tensor)
        for tensor in (*graph.initializer, *made):
            self.weights.add(tensor.name)
            self._set(tensor.name, tensor.data_type, tuple(tensor.dims))
            if math.prod(tensor.dims) <= _SMALL:
                self.tensors[tensor.name] = onnx.TensorProto.FromString(tensor.SerializeToString())
        large = [tensor for tensor in graph.initializer if tensor.name not in self.tensors]
        graph.input.extend(
            helper.make_tensor_value_info(tensor.name, tensor.data_type, tensor.dims) for tensor in large
        )
        kept = [self.tensors[tensor.name] for tensor in graph.initializer if tensor.name in self.tensors]
        del graph.initializer[:]
        graph.initializer.extend(kept)

    def _feed(self, value: onnx.ValueInfoProto, shapes: Mapping[str, Shape]) -> None:
        tensor = value.type.tensor_type
        declared = [axis.dim_value if axis.HasField("dim_value") else None for axis in tensor.shape.dim]
        shape = shapes.get(value.name)
        if shape is None or not tensor.HasField("shape") or len(declared) != len(shape):
            fits = False
        else:
            fits = all(one in (None, size) for one, size in zip(declared, shape, strict=True))
        if shape is None or not fits or tensor.elem_type != onnx.TensorProto.FLOAT:
            expected = f"inputs {dict(shapes)}, or names for their sizes"[:300]
            raise self._refuse(f"an input {value.name[:100]!r} of shape {declared}"[:200], expected)
        value.CopyFrom(helper.make_tensor_value_info(value.name, tensor.elem_type, shape))
        self._set(value.name, tensor.elem_type, shape)

    def _infer(self, node: onnx.NodeProto, nodes: Sequence[onnx.NodeProto]) -> None:
        """Learn types and shapes of a node's outputs."""
        outputs = list(filter(None, node.output))
        found = self._inferred([node])
        all_sizes = [size for _, sizes in found.values() for size in sizes]
        # A size that is not known may follow from computed values; else it depends on data.
        unknown = len(found) < len(outputs) or not all(map(self._is_known, all_sizes))
        if unknown and (node.op_type not in _SIZING or self._is_followed(node)):
            found = self._inferred([*self._sizing(node, nodes), node], data_prop=True)
        for output, (kind, sizes) in found.items():
            self._set(
                output,
                kind,
                tuple(size if self._is_known(size) else f"{size} of {outputs[0]}" for size in sizes),
            )

    def _is_known(self, size: int | str) -> bool:
        return isinstance(size, int) or size in self.bounds

    def _is_followed(self, node: onnx.NodeProto) -> bool:
        """Whether ``onnx`` may follow values through a node, for it has small tensors."""
        if node.op_type in ("Shape", "Size"):
            return True
        sizes = [self.sizes[name] for name in node.input if name]
        few = all(len(size) != 1 or self._size(size[0]) <= _SMALL for size in sizes)
        return node.op_type in _SIZING and few and len(sizes) <= _SMALL

    def _sizing(self, node: onnx.NodeProto, nodes: Sequence[onnx.NodeProto]) -> list[onnx.NodeProto]:
        """The nodes that compute what a node takes as sizes, in their order."""
        found: set[int] = set()
        waiting = list(node.input)
        while waiting:
            index = self.makers.get(waiting.pop())
            if index is not None and index not in found:
                found.add(index)
                waiting += () if nodes[index].op_type in ("Shape", "Size") else nodes[index].input
        self.followed += len(found)
        if self.followed > _MAX_SIZING:
            raise self._refuse("more work for sizes", f"at most {_MAX_SIZING} nodes that compute sizes")
        return [nodes[index] for index in sorted(found)]

    def _inferred(
        self, nodes: list[onnx.NodeProto], *, data_prop: bool = False
    ) -> dict[str, tuple[int, tuple[int | str, ...]]]:
        """Types and shapes of the outputs of the last of some nodes."""
        made = {output for node in nodes for output in node.output}
        given = {name for node in nodes for name in node.input if name} - made
        inputs = [
            helper.make_tensor_value_info(name, self.kinds[name], self.sizes[name])
            for name in given - self.tensors.keys()
        ]
        tensors = [self.tensors[name] for name in given & self.tensors.keys()]
        part = helper.make_model(
            helper.make_graph(nodes, "part", inputs, [], tensors), opset_imports=self.model.opset_import
        )
        inferred = shape_inference.infer_shapes(part, check_type=True, strict_mode=True, data_prop=data_prop)
        return {
            value.name: (
                value.type.tensor_type.elem_type,
                tuple(
                    one.dim_value if one.HasField("dim_value") else one.dim_param
                    for one in value.type.tensor_type.shape.dim
                ),
            )
            for value in inferred.graph.value_info
            if value.name in nodes[-1].output and value.type.tensor_type.HasField("shape")
        }

    def _set(self, name: str, kind: int, sizes: tuple[int | str, ...]) -> None:
        self.kinds[name], self.sizes[name] = kind, sizes

    def _bound(self, node: onnx.NodeProto) -> None:
        """Find a bound for every size of a node's outputs."""
        for output in filter(None, node.output):
            if output not in self.sizes:
                raise self._refuse_size(node)
            for axis, size in enumerate(self.sizes[output]):
                if isinstance(size, str) and size not in self.bounds:
                    self.bounds[size] = self._largest(node, axis) if size else self._none(node)
            self._require_size(node.op_type, tuple(map(self._size, self.sizes[output])))

    def _largest(self, node: onnx.NodeProto, axis: int) -> int:
        """The largest that a size may be which a node makes from data."""
        if node.op_type in _NO_LARGER:
            return self._elements(node.input[0])
        if node.op_type == "Concat" and helper.get_node_attr_value(node, "axis") in (
            axis,
            axis - len(self.sizes[node.output[0]]),
        ):
            return sum(self._size(self.sizes[name][axis]) for name in node.input)
        return self._none(node)

    def _none(self, node: onnx.NodeProto) -> int:
        raise self._refuse_size(node)

    def _check_division(self, node: onnx.NodeProto) -> None:
        """Integers that are divided by -1 or 0 may end the process, so a divisor is a constant of others."""
        if node.op_type not in ("Div", "Mod") or self.kinds.get(node.input[0]) not in _INTEGERS:
            return
        divisor = self.tensors.get(node.input[1])
        if divisor is None or not np.all(numpy_helper.to_array(divisor) > 0):
            raise self._refuse(f"{node.op_type} of integers by what is not known", "a constant above 0")

    def _check_memory(self, graph: onnx.GraphProto, nodes: Sequence[onnx.NodeProto]) -> None:
        """Bound the bytes that live together while nodes are computed in their order.

        Inputs and constants stay, and so does what follows from constants: onnxruntime computes that once.
        """
        uses = Counter(name for node in nodes for name in node.input)
        uses.update(value.name for value in graph.output)
        constant = set(self.weights)
        stays = constant | {value.name for value in graph.input}
        alive = most = sum(map(self._bytes, stays))
        for node in nodes:
            inputs, outputs = list(filter(None, node.input)), set(filter(None, node.output))
            if constant.issuperset(inputs):
                constant |= outputs
                stays |= outputs
            alive += sum(map(self._bytes, outputs))
            most = max(most, alive)
            uses.subtract(inputs)
            done = {name for name in (*inputs, *outputs) if uses[name] <= 0} - stays
            alive -= sum(map(self._bytes, done))
        if most > MAX_RUN_BYTES:
            raise self._refuse(
                f"{most / 2**20:.0f} MiB of memory in a run", f"at most {MAX_RUN_BYTES // 2**20} MiB"
            )

    def _elements(self, name: str) -> int:
        return math.prod(map(self._size, self.sizes[name]))

    def _bytes(self, name: str) -> int:
        return self._elements(name) * _itemsize(self.kinds[name])

    def _size(self, size: int | str) -> int:
        return self.bounds[size] if isinstance(size, str) else size

    def _require_size(self, what: str, shape: Shape) -> None:
        fits = len(shape) <= MAX_RANK and all(0 <= size <= MAX_ELEMENTS for size in shape)
        if not fits or math.prod(shape) > MAX_ELEMENTS:
            got = f"a tensor of shape {list(shape)} by {what}"[:200]
            raise self._refuse(got, f"at most {MAX_RANK} sizes, together at most {MAX_ELEMENTS} elements")

    def _refuse_size(self, node: onnx.NodeProto) -> BundleIntegrityError:
        return self._refuse(
            f"{node.op_type} with a size that depends on data", "sizes that follow from the inputs'"
        )

    def _refuse(self, got: str, expected: str) -> BundleIntegrityError:
        return _refusal(self.name, got, expected)


def _constant(node: onnx.NodeProto) -> onnx.TensorProto:
    value = node.attribute[0] if len(node.attribute) == len(node.output) == 1 else onnx.AttributeProto()
    tensor = onnx.TensorProto()
    if value.HasField("t"):
        tensor.CopyFrom(value.t)
    else:
        kind = np.int64 if value.name in ("value_int", "value_ints") else np.float32
        tensor = numpy_helper.from_array(np.asarray(helper.get_attribute_value(value), kind))
    tensor.name = node.output[0]
    return tensor


def _itemsize(kind: int) -> int:
    return int(helper.tensor_dtype_to_np_dtype(kind).itemsize)


def _refusal(name: str, got: str, expected: str = "an ONNX graph") -> BundleIntegrityError:
    return BundleIntegrityError(
        f"{name} cannot be opened",
        expected=expected,
        got=got,
        remedy="export the graph again with the project's exporters",
    )
