"""The operators that a bundle's graph may use.

First what the project's own exporters write; then, so that a network of one's own can be exported, too,
the operators of the standard set that compute a tensor from tensors: activations, arithmetic, comparisons,
shapes, convolution, pooling, normalisation, products and reductions. Left out is what

- is random, for randomness is an input of a bundle's graphs,
- reads or makes other things than tensors of numbers (texts, sequences, optionals, pictures),
- runs another graph: If and Scan, which no exporter of the project writes. Loop is in, as the search for ways
  needs it, with a number of turns that is written in the graph (see :mod:`cspace.bundle.onnx.loops`),
- steps through a sequence (LSTM, GRU, RNN), or is quantised.

Operators of other domains than ONNX's own are never known: some of them load code and files.
"""

_WRITTEN = """
Abs Add ArgMax Atan AveragePool Cast CastLike Ceil Clip Concat Constant Conv Cos CumSum DepthToSpace Div
Erf Exp Expand Flatten Floor Gather GatherElements GatherND Gemm GlobalAveragePool Greater Identity IsNaN
LeakyRelu Less LessOrEqual Loop MatMul Max MaxPool Min Mod Mul Neg Not Pow Range ReduceMax ReduceMean
ReduceMin ReduceSum Reshape Resize Round ScatterElements Shape Sigmoid Sin Size Slice Softmax Split Sqrt
Squeeze Sub Sum Tanh TopK Transpose Unsqueeze Where
"""
_ACTIVATIONS = """
Celu Elu Gelu HardSigmoid HardSwish Hardmax LogSoftmax Mish PRelu Relu Selu Softplus Softsign Swish
ThresholdedRelu
"""
_ARITHMETIC = """
Acos Acosh And Asin Asinh Atanh Cosh Dropout Equal GreaterOrEqual IsInf Log Mean Or Reciprocal Sign Sinh
Tan Xor
"""
_SHAPES = """
ArgMin Compress ConstantOfShape EyeLike GridSample NonZero OneHot Pad ScatterND SpaceToDepth Tile Trilu
"""
_LAYERS = """
BatchNormalization ConvTranspose Einsum GlobalLpPool GlobalMaxPool GroupNormalization
InstanceNormalization LRN LayerNormalization LpNormalization LpPool MeanVarianceNormalization
RMSNormalization ReduceL1 ReduceL2 ReduceLogSum ReduceLogSumExp ReduceProd ReduceSumSquare
"""

OPERATORS = frozenset(f"{_WRITTEN} {_ACTIVATIONS} {_ARITHMETIC} {_SHAPES} {_LAYERS}".split())
# The project's local functions are inlined; the name of their domain stays among the imports.
DOMAINS = ("", "ai.onnx", "cspace")
STANDARD = ("", "ai.onnx")
OLDEST_OPSET, NEWEST_OPSET = 11, 26
