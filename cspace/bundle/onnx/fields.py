"""The fields of ONNX that a bundle's graph may use, by message and number; what is not here is refused.

Left out on purpose: functions of the model's own (25) and references to their attributes, training (20),
device configurations, sparse tensors, quantisation, lists of graphs and tensors, segments and texts in
tensors, and every type but plain tensors. The project's exporters write none of them: functions are inlined.
A tensor's ``external_data`` and ``data_location`` are here to be refused by their names.
"""

from cspace.bundle.onnx.wire import Form, Kind, Rule

_N, _F, _D, _T, _B, _M, _NOTE = (
    Form.NUMBER, Form.FLOAT, Form.DOUBLE, Form.TEXT, Form.BYTES, Form.MESSAGE, Form.NOTE,
)  # fmt: skip
_DOC, _PROPS = Rule("doc_string", _NOTE, many=True), Rule("metadata_props", _NOTE, many=True)

MODEL: Kind = {
    1: Rule("ir_version", _N),
    2: Rule("producer_name", _NOTE, many=True),
    3: Rule("producer_version", _NOTE, many=True),
    4: Rule("domain", _NOTE, many=True),
    5: Rule("model_version", _N),
    6: _DOC,
    7: Rule("graph", _M),
    8: Rule("opset_import", _M, many=True),
    14: _PROPS,
}
OPSET: Kind = {1: Rule("domain", _T), 2: Rule("version", _N)}
GRAPH: Kind = {
    1: Rule("node", _M, many=True),
    2: Rule("name", _T),
    5: Rule("initializer", _M, many=True),
    10: _DOC,
    11: Rule("input", _M, many=True),
    12: Rule("output", _M, many=True),
    13: Rule("value_info", _M, many=True),
    16: _PROPS,
}
NODE: Kind = {
    1: Rule("input", _T, many=True),
    2: Rule("output", _T, many=True),
    3: Rule("name", _T),
    4: Rule("op_type", _T),
    5: Rule("attribute", _M, many=True),
    6: _DOC,
    7: Rule("domain", _T),
    8: Rule("overload", _T),
    9: _PROPS,
}
ATTRIBUTE: Kind = {
    1: Rule("name", _T),
    2: Rule("f", _F),
    3: Rule("i", _N),
    4: Rule("s", _B),
    5: Rule("t", _M),
    6: Rule("g", _M),
    7: Rule("floats", _F, many=True),
    8: Rule("ints", _N, many=True),
    9: Rule("strings", _B, many=True),
    13: _DOC,
    20: Rule("type", _N),
}
TENSOR: Kind = {
    1: Rule("dims", _N, many=True),
    2: Rule("data_type", _N),
    4: Rule("float_data", _F, many=True),
    5: Rule("int32_data", _N, many=True),
    7: Rule("int64_data", _N, many=True),
    8: Rule("name", _T),
    9: Rule("raw_data", _B),
    10: Rule("double_data", _D, many=True),
    11: Rule("uint64_data", _N, many=True),
    12: _DOC,
    13: Rule("external_data", _B, many=True),
    14: Rule("data_location", _N),
    16: _PROPS,
}
VALUE: Kind = {1: Rule("name", _T), 2: Rule("type", _M), 3: _DOC, 4: _PROPS}
TYPE: Kind = {1: Rule("tensor_type", _M), 6: Rule("denotation", _T)}
TENSOR_TYPE: Kind = {1: Rule("elem_type", _N), 2: Rule("shape", _M)}
SHAPE: Kind = {1: Rule("dim", _M, many=True)}
DIMENSION: Kind = {1: Rule("dim_value", _N), 2: Rule("dim_param", _T), 3: Rule("denotation", _T)}

# The number of an attribute's type to the one field that holds its value.
ATTRIBUTE_VALUES = {1: "f", 2: "i", 3: "s", 4: "t", 5: "g", 6: "floats", 7: "ints", 8: "strings"}
