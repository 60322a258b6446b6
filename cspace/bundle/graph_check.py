"""Checks a bundle's ONNX graphs before onnxruntime opens them: whole, standard, and without control flow.

The bytes come from whoever may write to the registry. A graph passes if ``onnx.checker`` takes it, if it is
all in its file, and if it has operators of ONNX's standard set alone that compute tensors from tensors. What
it costs is shown by the golden case, in a process with limits of time and memory
(:mod:`cspace.bundle.verification`). Whoever needs more signs their models.

``onnx`` takes about a second to import, so servers never import this module.
"""

from collections.abc import Mapping

import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]
from onnx import checker

from cspace.errors import BundleIntegrityError

MAX_NODES = 10_000
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
_GRAPHS = (onnx.AttributeProto.GRAPH, onnx.AttributeProto.GRAPHS)


def check_graphs(contents: Mapping[str, bytes]) -> None:
    """Check all graphs of a bundle, by the names of their files."""
    for name, data in contents.items():
        if name.endswith(".onnx"):
            check_graph(name, data)


def check_graph(name: str, data: bytes) -> None:
    """Check one graph."""
    try:
        model = onnx.load_from_string(data)
    except (DecodeError, ValueError, RecursionError) as error:
        raise _refusal(name, "bytes that are no ONNX graph") from error
    versions = {one.domain: one.version for one in model.opset_import}
    nodes, tensors = model.graph.node, [*model.graph.initializer]
    tensors += [one.t for node in nodes for one in node.attribute if one.HasField("t")]
    standard = {domain: version for domain, version in versions.items() if domain in DOMAINS[:2]}
    operators = {f"{node.domain}:{node.op_type}" for node in nodes if node.domain not in DOMAINS[:2]}
    operators |= {node.op_type for node in nodes} - OPERATORS
    wrong = {
        "functions, training or sparse tensors": model.functions
        or model.training_info
        or model.graph.sparse_initializer,
        f"operators of {sorted(versions.items())}": set(versions) - set(DOMAINS) or len(standard) != 1,
        f"opset {sorted(standard.values())}": not all(
            OLDEST_OPSET <= version <= NEWEST_OPSET for version in standard.values()
        ),
        f"{len(nodes)} nodes": len(nodes) > MAX_NODES,
        f"the operators {', '.join(sorted(operators))}": operators,
        "a graph within a graph": any(one.type in _GRAPHS for node in nodes for one in node.attribute),
        "a tensor that keeps its weights outside the bundle": any(
            one.data_location or one.external_data for one in tensors
        ),
    }
    found = next((what for what, is_wrong in wrong.items() if is_wrong), None)
    if found is not None:
        raise _refusal(name, found[:300])
    try:
        checker.check_model(model, full_check=True)
    except (checker.ValidationError, onnx.shape_inference.InferenceError, ValueError, TypeError) as error:
        raise _refusal(name, (str(error) or type(error).__name__).splitlines()[0][:300]) from error


def _refusal(name: str, got: str) -> BundleIntegrityError:
    return BundleIntegrityError(
        f"{name} cannot be opened",
        expected=f"a whole ONNX graph of at most {MAX_NODES} nodes, of standard operators of the opsets "
        f"{OLDEST_OPSET} to {NEWEST_OPSET} that compute tensors from tensors",
        got=got,
        remedy="export the graph again with the project's exporters",
    )
