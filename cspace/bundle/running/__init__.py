"""Graphs in onnxruntime: sessions, their limits of time, and batches in chunks."""
