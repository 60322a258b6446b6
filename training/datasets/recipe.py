"""What a generated data set has to tell, so that its shards can be made anywhere and put together."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray
from pydantic import BaseModel

from cspace.dataset import Dataset
from training.datasets.shards import Shard

Arrays = Mapping[str, NDArray[Any]]


class Recipe(Protocol):
    """A configuration with what is made of it."""

    @property
    def config(self) -> BaseModel:
        """All that fixes the data."""
        ...

    @property
    def key(self) -> str:
        """Twelve hex digits that change with every field that changes the data."""
        ...

    @property
    def finished_bytes(self) -> int:
        """About how large the arrays are."""
        ...

    def plan(self) -> list[Shard]:
        """All shards in order."""
        ...

    def make(self, shard: Shard) -> dict[str, NDArray[Any]]:
        """The arrays of one shard; the same wherever it is computed."""
        ...

    def write(self, folder: Path, load: Callable[[Shard], Arrays]) -> Dataset:
        """The whole data set of its finished shards."""
        ...
