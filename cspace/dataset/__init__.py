"""Data sets: a folder of arrays with a manifest, written whole or not at all."""

from cspace.dataset.folder import Dataset, open_dataset, require_room, write_dataset

__all__ = ["Dataset", "open_dataset", "require_room", "write_dataset"]
