"""ONNX's wire format, read by own code: what a graph holds is checked before a runtime sees it."""
