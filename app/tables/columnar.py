"""Parquet, Feather and Arrow files within the size limit, which is checked on the unpacked size before reading.

What is counted is what the reader would have to make, never what the file says of itself alone: few kB of repeated
values unpack to more than any memory holds.
"""

import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.arrays import column_cells, refuse_large
from softcal.app.tables.headings import IsRequested, refuse_duplicates
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Column, Table
from softcal.core.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

UNNAMED_INDEX = "__index_level_0__"
"""How pandas writes an index that has no name."""

UNIT_KEYS = (b"unit", b"units", b"unit_string")
BYTES_PER_CELL = 8
ARROW_MAGIC = b"ARROW1\0\0"


def read_parquet(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the requested columns of a Parquet file.

    Raises:
        InputError: too large, a name twice, or a column that is neither number, time nor text.
    """
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    schema = pq.read_schema(file)
    names = _requested_names(schema, path, is_requested)
    text = [name for name in names if _is_text(schema.field(name).type)]
    file.seek(0)
    # Equal texts stay one text: a column of them may otherwise unpack to any size.
    parquet_file = pq.ParquetFile(file, page_checksum_verification=True, read_dictionary=text)
    # The footer may lie: the row groups say it again, and pyarrow checks pages against them.
    groups = [parquet_file.metadata.row_group(k) for k in range(parquet_file.metadata.num_row_groups)]
    rows = max(int(parquet_file.metadata.num_rows), sum(int(group.num_rows) for group in groups))
    refuse_large(path, rows * sum(_width(schema.field(name).type) for name in names), options.max_cells)
    if text:
        # What the file unpacks to, with the columns that nobody asks for. A column's own facts are not looked at: where
        # they contradict the schema, pyarrow ends the whole process there; reading the column refuses them in order.
        # Numbers need no such count: their rows say how much they take.
        unpacked_bytes = sum(int(group.total_byte_size) for group in groups)
        refuse_large(path, unpacked_bytes // BYTES_PER_CELL, options.max_cells)
    # Without a column the first one tells the number of rows.
    table = parquet_file.read(columns=names or schema.names[:1])
    for name in text:
        # What the texts would take one after another
        lengths = (pc.take(pc.binary_length(chunk.dictionary), chunk.indices) for chunk in table[name].chunks)
        unpacked_bytes = sum(int(pc.sum(each).as_py() or 0) for each in lengths)
        refuse_large(path, unpacked_bytes // BYTES_PER_CELL, options.max_cells)
    return _table(table, names, schema, path)


def read_arrow(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the requested columns of a Feather or Arrow file, read as the stream that both hold.

    Raises:
        InputError: too large, a name twice, the Feather of before 2020, or a column that is neither number, time nor
            text.
    """
    import pyarrow as pa

    content = file.read()
    if content.startswith(b"FEA1"):
        raise InputError(f"{path}: a Feather file of version 1; write it again with pandas or pyarrow of today")
    # The footer of a file is left aside: it may name other blocks than those that were counted.
    stream = pa.py_buffer(content[len(ARROW_MAGIC) :] if content.startswith(ARROW_MAGIC) else content)
    messages, bytes_unpacked = pa.ipc.MessageReader.open_stream(stream), 0
    while True:
        try:
            message = messages.read_next_message()
        except StopIteration:
            break
        bytes_unpacked += _unpacked_bytes(message)
        refuse_large(path, bytes_unpacked // BYTES_PER_CELL, options.max_cells)
    reader = pa.ipc.open_stream(stream)
    names = _requested_names(reader.schema, path, is_requested)
    return _table(reader.read_all(), names, reader.schema, path)


def _requested_names(schema: "pa.Schema", path: Path, is_requested: IsRequested) -> list[str]:
    refuse_duplicates(schema.names, path, is_requested)
    names = [name for name in schema.names if is_requested is None or is_requested(_column_name(name, schema))]
    for name in names:
        if not _is_column(schema.field(name).type):
            raise InputError(
                f"{path}: column {name!r} holds {schema.field(name).type} (lists or records) where numbers were "
                "expected; export it as a column of numbers"
            )
    return names


def _column_name(name: str, schema: "pa.Schema") -> str:
    return "index" if name == UNNAMED_INDEX and "index" not in schema.names else name


def _is_text(kind: "pa.DataType") -> bool:
    import pyarrow.types as kinds

    return bool(kinds.is_string(kind) or kinds.is_binary(kind))


def _is_column(kind: "pa.DataType") -> bool:
    import pyarrow.types as kinds

    if kinds.is_dictionary(kind):
        return _is_column(kind.value_type)
    if kinds.is_nested(kind) or kinds.is_run_end_encoded(kind):
        return False
    tests = (kinds.is_primitive, kinds.is_boolean, kinds.is_decimal, kinds.is_null, _is_text)
    return any(is_kind(kind) for is_kind in (*tests, kinds.is_large_string, kinds.is_large_binary))


def _width(kind: "pa.DataType") -> int:
    try:
        return 1 if _is_text(kind) else max(1, int(kind.bit_width) // 64)
    except ValueError:
        return 1  # A type without a width


def _table(table: "pa.Table", names: list[str], schema: "pa.Schema", path: Path) -> Table:
    column_names = {name: _column_name(name, schema) for name in schema.names}
    columns = []
    for name in names:
        field_metadata = schema.field(name).metadata or {}
        unit = next((field_metadata[key].decode("utf-8", "replace") for key in UNIT_KEYS if key in field_metadata), "")
        # What has a zone is stored in UTC.
        unit = "UTC" if getattr(schema.field(name).type, "tz", None) else unit
        columns.append(Column(column_names[name].strip(), unit.strip(), column_cells(path, name, _array(table[name]))))
    return Table(path, tuple(columns), tuple(column_names.values()), np.arange(1, table.num_rows + 1))


def _array(column: "pa.ChunkedArray") -> NDArray[Any]:
    import pyarrow as pa
    import pyarrow.types as kinds

    kind = column.type
    if kinds.is_dictionary(kind):
        codes = [chunk.indices.fill_null(0).to_numpy(zero_copy_only=False) for chunk in column.chunks]
        texts = [_array(pa.chunked_array([chunk.dictionary])) for chunk in column.chunks]
        parts = [np.where(c.is_null(), None, t[k]) for c, t, k in zip(column.chunks, texts, codes, strict=True)]
        return np.concatenate(parts) if parts else np.zeros(0)
    if kinds.is_decimal(kind) or kinds.is_null(kind) or (kinds.is_integer(kind) and column.null_count):
        column, kind = column.cast(pa.float64(), safe=False), pa.float64()
    if kinds.is_time(kind):
        column = column.cast(pa.int64() if kind.bit_width == 64 else pa.int32()).cast(pa.int64())
        column = column.cast(pa.duration(kind.unit))
    elif kinds.is_date(kind):
        column = column.cast(pa.timestamp("ns"))
    elif kinds.is_boolean(kind) or _is_text(kind):
        return np.array(column.to_pylist(), dtype=object)
    values: NDArray[Any] = column.to_numpy()
    return values


def _unpacked_bytes(message: "pa.ipc.Message") -> int:
    """Return the unpacked size of a record batch in bytes, from the first 8 bytes of each buffer.

    Arrow allocates that many and refuses a buffer that unpacks to another number. Layout: Message.fbs and Schema.fbs of
    Arrow's columnar format; a flatbuffer's table begins with the offset back to its table of fields.
    """
    body = message.body
    if message.type not in ("record batch", "dictionary") or body is None:
        return 0
    data = message.metadata.to_pybytes()
    batch = _field(data, struct.unpack_from("<I", data, 0)[0], 2)
    if message.type == "dictionary":
        batch = _field(data, batch, 1)
    buffers, is_compressed = _field(data, batch, 2), _field(data, batch, 3)
    total = 0
    for k in range(struct.unpack_from("<I", data, buffers)[0] if buffers else 0):
        start, size = struct.unpack_from("<qq", data, buffers + 4 + 16 * k)
        if is_compressed and size >= 8:
            total += max(size, *struct.unpack_from("<q", body[start : start + 8].to_pybytes(), 0))
        else:
            total += size
    return total


def _field(data: bytes, table: int, number: int) -> int:
    """Return where a flatbuffer's table holds what its field points to; 0 where the field is absent."""
    fields = table - struct.unpack_from("<i", data, table)[0]
    if 4 + 2 * number >= struct.unpack_from("<H", data, fields)[0]:
        return 0
    offset = struct.unpack_from("<H", data, fields + 4 + 2 * number)[0]
    return table + offset + struct.unpack_from("<I", data, table + offset)[0] if offset else 0
