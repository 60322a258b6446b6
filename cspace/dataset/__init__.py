"""Data sets: a folder of arrays with a manifest, written whole or not at all."""

from cspace.dataset.checks import TOLD
from cspace.dataset.folder import Dataset, open_dataset, require_room, write_dataset

__all__ = ["TOLD", "Dataset", "open_dataset", "require_room", "write_dataset"]
