"""The files of a bundle: read once, held against their sums, and what is allowed in its graphs."""

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from cspace.errors import BundleIntegrityError

SPEC_FILE = "bundle.json"
ENCODER_FILE = "encoder.onnx"
GENERATOR_FILE = "generator.onnx"
VALIDITY_FILE = "validity.onnx"
NOVELTY_FILE = "novelty.onnx"
MAP_FILE = "map.onnx"
FIELD_FILE = "field.onnx"
GOLDEN_FILE = "golden.npz"
SUMS_FILE = "SHA256SUMS"
REQUIRED_FILES = (SPEC_FILE, ENCODER_FILE, GOLDEN_FILE)
OPTIONAL_FILES = (GENERATOR_FILE, VALIDITY_FILE, NOVELTY_FILE, MAP_FILE, FIELD_FILE)

# The shipped bundle's largest graph has 1.3 MB, its description 11 kB.
LIMITS_BYTES = {SPEC_FILE: 2**20, GOLDEN_FILE: 4 * 2**20, SUMS_FILE: 16 * 2**10} | dict.fromkeys(
    (ENCODER_FILE, *OPTIONAL_FILES), 256 * 2**20
)
_LINE = re.compile(r"([0-9a-f]{64})  ([A-Za-z0-9._-]+)")


@dataclass(frozen=True, slots=True)
class BundleFiles:
    """A bundle's verified bytes."""

    contents: Mapping[str, bytes]  # file name to bytes, ``SHA256SUMS`` left out
    digest: str  # SHA-256 of ``SHA256SUMS``, which names the bundle


def sums_of(contents: Mapping[str, bytes]) -> bytes:
    """``SHA256SUMS`` for the given files, in the form that ``sha256sum --check`` reads."""
    lines = [f"{hashlib.sha256(contents[name]).hexdigest()}  {name}\n" for name in sorted(contents)]
    return "".join(lines).encode()


def read_files(folder: Path) -> BundleFiles:
    """Read the plain files straight in a bundle's folder and hold them against its ``SHA256SUMS``."""
    try:
        contents = _read_all(folder)
    except (OSError, ValueError) as error:
        raise BundleIntegrityError("the bundle cannot be read", got=type(error).__name__) from error
    sums = contents.pop(SUMS_FILE, b"")
    matches = [_LINE.fullmatch(line) for line in sums.decode("ascii", errors="replace").splitlines()]
    listed = {match[2]: match[1] for match in matches if match is not None}
    if None in matches or set(listed) != set(contents) or not set(REQUIRED_FILES) <= set(contents):
        names = sorted((set(REQUIRED_FILES) | set(listed)) ^ set(contents))
        raise _broken(", ".join(names) or SUMS_FILE, "missing, or not as SHA256SUMS lists it")
    for name, data in contents.items():
        if hashlib.sha256(data).hexdigest() != listed[name]:
            raise _broken(name, "changed since its sum was written")
    return BundleFiles(contents, hashlib.sha256(sums).hexdigest())


def _read_all(folder: Path) -> dict[str, bytes]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name not in LIMITS_BYTES:
                shown = entry.name.encode("utf-8", "backslashreplace").decode()[:100]
                raise _broken(shown, "not part of a bundle")
            if not entry.is_file(follow_symlinks=False):
                raise _broken(entry.name, "not a plain file")
            if entry.stat().st_size > LIMITS_BYTES[entry.name]:
                raise _broken(entry.name, "more than a bundle may hold")
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def _broken(name: str, problem: str) -> BundleIntegrityError:
    return BundleIntegrityError(
        f"{name}: {problem}",
        expected=f"{', '.join(REQUIRED_FILES)}, perhaps {', '.join(OPTIONAL_FILES)}",
        remedy="fetch the bundle again, or export it again",
    )


MAX_NODES = 10_000
OLDEST_OPSET, NEWEST_OPSET = 11, 26
# Local functions of the project are inlined; the name of their domain stays among the imports.
DOMAINS = ("", "ai.onnx", "cspace")

# What the project's exporters write, and what a network of one's own may need. Left out are operators that
# draw at random, make anything but tensors of numbers, run another graph, step through sequences or quantise.
OPERATORS = frozenset(
    """
Abs Acos Acosh Add And ArgMax ArgMin Asin Asinh Atan Atanh AveragePool BatchNormalization Cast CastLike Ceil
Celu Clip Compress Concat Constant ConstantOfShape Conv ConvTranspose Cos Cosh CumSum DepthToSpace Div Dropout
Einsum Elu Equal Erf Exp Expand EyeLike Flatten Floor Gather GatherElements GatherND Gelu Gemm
GlobalAveragePool GlobalLpPool GlobalMaxPool Greater GreaterOrEqual GridSample GroupNormalization HardSigmoid
HardSwish Hardmax Identity InstanceNormalization IsInf IsNaN LRN LayerNormalization LeakyRelu Less LessOrEqual
Log LogSoftmax LpNormalization LpPool MatMul Max MaxPool Mean MeanVarianceNormalization Min Mish Mod Mul Neg
NonZero Not OneHot Or PRelu Pad Pow RMSNormalization Range Reciprocal ReduceL1 ReduceL2 ReduceLogSum
ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Relu Reshape Resize Round
ScatterElements ScatterND Selu Shape Sigmoid Sign Sin Sinh Size Slice Softmax Softplus Softsign SpaceToDepth
Split Sqrt Squeeze Sub Sum Swish Tan Tanh ThresholdedRelu Tile TopK Transpose Trilu Unsqueeze Where Xor
""".split()  # noqa: SIM905
)


def check_graph(name: str, data: bytes) -> None:
    """Check an ONNX graph before onnxruntime opens it: whole, standard, and without control flow.

    A graph passes if ``onnx.checker`` takes it, if it is all in its file, and if it has operators of ONNX's
    standard set alone that compute tensors from tensors. What it costs is shown by the golden case, in a
    process with limits of time and memory (:func:`cspace.bundle.load_verified`).
    """
    # A second and 40 MiB, which a server does without.
    import onnx  # noqa: PLC0415
    from google.protobuf.message import DecodeError  # type: ignore[import-untyped] # noqa: PLC0415
    from onnx import checker  # noqa: PLC0415

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
    graphs = (onnx.AttributeProto.GRAPH, onnx.AttributeProto.GRAPHS)
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
        "a graph within a graph": any(one.type in graphs for node in nodes for one in node.attribute),
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
