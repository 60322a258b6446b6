"""The Open Inference Protocol, version 2: tensors instead of fields."""
