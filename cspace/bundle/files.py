"""The files of a bundle: sums, what is allowed in graphs, and the golden case.

The golden case is a request with the answers that the bundle gave where it was written.
"""

import hashlib
import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cspace.errors import BundleIntegrityError, GoldenMismatchError
from cspace.query import SampleQuery
from cspace.space import JointSpace

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
    """Check an ONNX graph before onnxruntime opens it: whole, standard, and without control flow."""
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


# Of the archive, unpacked; a picture of 2048 pixels has 12.6 MB.
MAX_ARRAYS_BYTES = 32 * 2**20
TOLERANCE = 1e-4
_QUERY = ("count", "seed", "epsilon_sigma", "start", "goal")


@dataclass(frozen=True, slots=True)
class GoldenCase:
    """Inputs with their expected outputs; None where the model has no such thing."""

    image: NDArray[np.uint8]  # (P, P, 3), or as the world's pictures are
    query: SampleQuery
    mu: NDArray[np.float32]  # (L,)
    sigma: NDArray[np.float32]  # (L,)
    samples: NDArray[np.float32]  # (n, d) rad
    confidence: NDArray[np.float32] | None = None  # (n,), models with a validity head only

    def to_npz(self) -> bytes:
        query = self.query
        values: dict[str, Any] = {
            "count": query.n,
            "seed": np.uint64(query.seed),
            "epsilon_sigma": query.epsilon_sigma,
            "start": query.start,
            "goal": query.goal,
        }
        values |= {name: getattr(self, name) for name in ("image", "mu", "sigma", "samples", "confidence")}
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **{name: value for name, value in values.items() if value is not None})
        return buffer.getvalue()

    @classmethod
    def from_npz(cls, data: bytes) -> "GoldenCase":
        """The inverse of :meth:`to_npz`; never unpickles."""
        try:
            with np.load(io.BytesIO(data), allow_pickle=False) as archive:
                if sum(entry.file_size for entry in archive.zip.infolist()) > MAX_ARRAYS_BYTES:
                    raise ValueError(f"more than {MAX_ARRAYS_BYTES} bytes unpacked")  # noqa: TRY301
                values = dict(archive)
            asked = {name: values.pop(name).tolist() for name in _QUERY if name in values}
            query = SampleQuery.checked(asked.pop("count"), **asked, min_confidence=0.0)
            return cls(query=query, **values)
        except Exception as error:
            # All, for there is no list of what a damaged archive raises.
            raise BundleIntegrityError(
                "golden.npz is not a golden case",
                expected="a request and its answers, as cspace.bundle writes them",
                got=str(error)[:200] or type(error).__name__,
                remedy="export the bundle again",
            ) from error

    def compare(
        self,
        mu: NDArray[np.float32],
        sigma: NDArray[np.float32],
        samples: NDArray[np.float32],
        confidence: NDArray[np.float32] | None,
        space: JointSpace,
    ) -> None:
        """Hold a latent and answers against the expected ones, circles the shorter way round."""
        _close("mu", self.mu, mu)
        _close("sigma", self.sigma, sigma)
        _close("samples", self.samples, samples, space)
        if (self.confidence is None) != (confidence is None):
            raise GoldenMismatchError("the golden case and the bundle disagree on a validity head")
        if self.confidence is not None and confidence is not None:
            _close("confidence", self.confidence, confidence)


def _close(name: str, expected: NDArray[Any], got: NDArray[Any], space: JointSpace | None = None) -> None:
    if expected.shape != got.shape:
        raise GoldenMismatchError(f"the golden case's {name} is of shape {expected.shape}, not {got.shape}")
    gap = got.astype(np.float64) - expected if space is None else space.difference(expected, got)
    worst = float(np.max(np.abs(gap), initial=0.0))
    if not worst <= TOLERANCE:
        raise GoldenMismatchError(
            f"the golden case's {name} comes out differently here",
            expected=f"within {TOLERANCE}",
            got=f"off by {worst:.3g}",
            remedy="use the onnxruntime and numpy of the constraints file, or export the bundle again",
        )


def scene(size: Sequence[int]) -> NDArray[np.uint8]:
    """A fixed picture of a disc (P, P, 3), or (X, Y, Z, channels) of a ball in the middle of space."""
    place = np.stack(np.meshgrid(*(np.linspace(-1.0, 1.0, side) for side in size[:-1]), indexing="ij"))
    gap = np.linalg.norm(place, axis=0) - 0.4
    image = np.full(tuple(size), 255, dtype=np.uint8)
    if len(size) == 3:
        image[gap < 0.0, 1:] = 0
        return image
    hidden = (gap < 0.0) | ((np.linalg.norm(place[:2], axis=0) < 0.4) & (place[2] < 0.0))
    image[..., 0] = np.minimum(np.abs(gap) * 1000.0, 255.0)
    image[2:, ..., 1:] = np.where(hidden, np.clip(-gap * 250.0, 1.0, 253.0), 0.0)[2:, ..., None]
    return image


def endpoints(conditions: Sequence[str], space: JointSpace) -> tuple[tuple[float, ...] | None, ...]:
    """A fixed start and goal for path models, None for the others."""
    if not conditions:
        return None, None
    low, width = np.asarray(space.lower), np.subtract(space.upper, space.lower)
    return tuple(tuple((low + share * width).tolist()) for share in (0.4, 0.65))
