"""The runs as a Parquet file, which pandas reads."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import get_type_hints

import pyarrow as pa
import pyarrow.parquet as pq

from cspace.errors import StorageError
from services.evaluator.benchmark.runs.run import DESCRIPTIONS, Run

_KINDS: dict[object, pa.DataType] = {
    str: pa.string(),
    str | None: pa.string(),
    int: pa.int64(),
    int | None: pa.int64(),
    bool: pa.bool_(),
    float: pa.float64(),
    float | None: pa.float64(),
    tuple[float, ...]: pa.list_(pa.float64()),
    tuple[int, ...]: pa.list_(pa.int64()),
}
_SCHEMA = pa.schema(
    pa.field(name, _KINDS[kind], metadata={"what": DESCRIPTIONS[name]})
    for name, kind in get_type_hints(Run).items()
)


def write_parquet(runs: Sequence[Run], path: Path) -> None:
    """Write the table; what a column holds travels with it as metadata of its field.

    Raises:
        StorageError: the file can not be written.
    """
    table = pa.Table.from_pylist([asdict(run) for run in runs], schema=_SCHEMA)
    try:
        pq.write_table(table, path)
    except OSError as error:
        raise StorageError(f"{path} can not be written", got=str(error)) from error
