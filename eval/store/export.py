"""The cells of a run as a table for other programs."""

import csv
import importlib.util
import io
import json
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import IO, Any

from eval.store.reader import Reader, Value
from eval.store.schema import COLUMNS, SCHEMA
from railenv.errors import RailenvError, unknown_name
from railenv.files import replacing

_GROUP = 10_000
"""Cells that are held in memory at a time."""

ENDINGS = (".csv", ".parquet")
"""Formats by the ending of a file's name."""

_NO_PYARROW = (
    'Parquet needs pyarrow, which is not installed; run pip install "railenv[report]", or export '
    "to .csv"
)


def check_export(path: Path) -> None:
    """Raise if `export` could not write such a file, so that nobody learns it after a long run.

    Args:
        path: The file.

    Raises:
        ArgumentError: The ending is none of the formats'.
        RailenvError: Parquet needs pyarrow, which is not installed.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise unknown_name("format", path.suffix, ENDINGS)
    if ending == ".parquet" and importlib.util.find_spec("pyarrow") is None:
        raise RailenvError(_NO_PYARROW)


def export(folder: Path, path: Path) -> int:
    """Write all cells of a run to a file, in the order of controller and key.

    CSV has a header, an empty field for what was not measured, 0 or 1 for `unstable`, and numbers
    with all digits that they need to be read back bit for bit. Parquet has the columns' types,
    nulls, and the run's settings under the key `railenv` of its metadata.

    Args:
        folder: The run's folder.
        path: The file; its ending says the format, `.csv` or `.parquet`.

    Returns:
        How many cells were written.

    Raises:
        ArgumentError: The ending is another.
        InputFileError: There are no records, or they are damaged.
        OutputError: The file cannot be written; what stood there before is untouched.
        RailenvError: Parquet needs pyarrow, which is not installed.
    """
    check_export(path)
    write = _write_csv if path.suffix.lower() == ".csv" else _write_parquet
    with Reader.open(folder) as records, replacing(path) as stream:
        return write(records, stream)


def _write_csv(records: Reader, stream: IO[bytes]) -> int:
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    count = 0
    for row in records.rows():
        # csv writes None as nothing and a float by repr.
        table.writerow(int(value) if isinstance(value, bool) else value for value in row.values())
        count += 1
    text.detach()  # the stream stays open for whom it belongs to
    return count


def _write_parquet(records: Reader, stream: IO[bytes]) -> int:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise RailenvError(_NO_PYARROW) from None
    types = {"TEXT": pa.string(), "REAL": pa.float64(), "INTEGER": pa.int64()}
    columns = [(name, types[kind]) for name, kind in COLUMNS.items() if name != "unstable"]
    about = {"schema": SCHEMA, "created": records.created, **records.settings.plain()}
    schema = pa.schema(
        [*columns, ("unstable", pa.bool_())], metadata={"railenv": json.dumps(about)}
    )
    count = 0
    with parquet.ParquetWriter(stream, schema) as table:
        for group in _groups(records.rows()):
            table.write_table(pa.Table.from_pylist(group, schema=schema))
            count += len(group)
    return count


def _groups(rows: Iterator[dict[str, Value]]) -> Iterator[list[dict[str, Any]]]:
    while group := list(islice(rows, _GROUP)):
        yield group
