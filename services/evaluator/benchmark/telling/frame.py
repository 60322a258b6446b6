"""The runs as a Parquet file, which pandas reads."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast, get_type_hints

import pyarrow as pa
import pyarrow.parquet as pq

from cspace.errors import StorageError
from services.evaluator.benchmark.runs.run import Record, descriptions

_KINDS: dict[object, pa.DataType] = {
    str: pa.string(),
    str | None: pa.string(),
    int: pa.int64(),
    int | None: pa.int64(),
    bool: pa.bool_(),
    float: pa.float64(),
    float | None: pa.float64(),
    bool | None: pa.bool_(),
    tuple[float, ...]: pa.list_(pa.float64()),
    tuple[int, ...]: pa.list_(pa.int64()),
}


def write_parquet(runs: Sequence[Record], path: Path) -> None:
    """Write the table; what a column holds travels with it as metadata of its field.

    Args:
        runs: of one kind, one or more.
        path: of the file.

    Raises:
        StorageError: the file can not be written.
    """
    kind, rows = type(runs[0]), [asdict(cast("Any", run)) for run in runs]
    told = descriptions(kind)
    schema = pa.schema(
        pa.field(name, _KINDS[hint], metadata={"what": told[name]})
        for name, hint in get_type_hints(kind).items()
    )
    table = pa.Table.from_pylist(rows, schema=schema)
    try:
        pq.write_table(table, path)
    except OSError as error:
        raise StorageError(f"{path} can not be written", got=str(error)) from error
