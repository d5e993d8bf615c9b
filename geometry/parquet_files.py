"""Open Parquet files of users, unless too few bytes hold too many values."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .archives import refuse_ratio
from .opening import open_file, reading

_VALUE_BYTES = 8


@contextmanager
def open_parquet(path: Path, *, max_bytes: int, expected: str) -> Iterator[Any]:
    """Open a Parquet file, with its texts as dictionaries.

    Raises
    ------
    InputError
        The file is damaged, or too few bytes hold too many values.
    """
    import pyarrow as pa
    from pyarrow import parquet

    damage = (OSError, ValueError, pa.ArrowException)
    with open_file(path, max_bytes=max_bytes) as file, reading(path, expected, *damage):
        found = parquet.read_metadata(file)
        groups = [found.row_group(index) for index in range(found.num_row_groups)]
        columns = [
            group.column(at) for group in groups for at in range(group.num_columns)
        ]
        n_values = sum(column.num_values for column in columns)
        n_bytes = max(
            _VALUE_BYTES * n_values, sum(group.total_byte_size for group in groups)
        )
        refuse_ratio(n_bytes, os.fstat(file.fileno()).st_size, str(path))
        schema = [found.schema.column(index) for index in range(found.num_columns)]
        texts = [
            column.path for column in schema if column.physical_type == "BYTE_ARRAY"
        ]
        file.seek(0)
        with parquet.ParquetFile(file, metadata=found, read_dictionary=texts) as opened:
            yield opened
