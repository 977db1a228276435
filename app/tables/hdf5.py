"""HDF5 files: datasets of a group, compound datasets and the frames that pandas writes. No other file is opened."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from softcal.app.tables.arrays import Channel, choose_group, read_channels, refuse_large, unreadable_channel
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Table
from softcal.core.errors import InputError

if TYPE_CHECKING:
    import h5py

MAX_GROUPS = 10_000
UNIT_NAMES = ("unit", "units", "Unit", "Units", "unit_string")
TEXT_ROWS = 1000
"""Texts are read so many at a time: each may name the same long one."""

Groups = dict[str, list[Channel]]


def read_hdf5(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the requested columns of the declared group, or of the group with samples.

    Raises:
        InputError: several groups hold samples and none is declared, data of another file, object references,
            or too many cells.
    """
    import h5py

    with h5py.File(file, "r") as hdf5_file:
        groups: Groups = {}
        for name, group in _groups(path, hdf5_file):
            groups |= _frame_of_pandas(path, name, group, options) or _plain_channels(path, name, group, options)
        name = choose_group(path, groups, options, is_requested, "group")
        return read_channels(path, groups[name], options, is_requested, f"group {name!r}")


def _groups(path: Path, root: "h5py.Group") -> Iterator[tuple[str, "h5py.Group"]]:
    """Yield every group once, under its path without the first slash; the root is "/"."""
    import h5py

    pending, visited = [("/", root)], set()
    while pending:
        name, group = pending.pop(0)
        address = h5py.h5o.get_info(group.id).addr
        if address in visited:
            continue
        visited.add(address)
        if len(visited) > MAX_GROUPS:
            raise InputError(f"{path}: more than {MAX_GROUPS} groups; export the samples of one run alone")
        yield name, group
        if "pandas_type" not in group.attrs:
            pending += [(f"{name}/{k}".lstrip("/"), group[k]) for k in members(path, group, h5py.Group)]


def members(path: Path, group: "h5py.Group", kind: type) -> list[str]:
    """Return the names of a group's direct members of a kind, in order of writing if the file stores it.

    Raises:
        InputError: a member that lies in another file.
    """
    import h5py

    names = []
    for name in group:
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            raise InputError(
                f"{path}: {name!r} lies in another file ({link.filename}); give that file, or save all in one"
            )
        if isinstance(link, h5py.HardLink) and group.get(name, getclass=True) is kind:
            names.append(name)
    return names


def _plain_channels(path: Path, name: str, group: "h5py.Group", options: TableOptions) -> Groups:
    import h5py

    groups: Groups = {}
    columns: list[Channel] = []
    for key in members(path, group, h5py.Dataset):
        data = group[key]
        if data.dtype.names:
            parts = [_field(path, data, part, options) for part in data.dtype.names if not data.dtype[part].subdtype]
            if len(data.shape) == 1 and parts:
                groups[f"{name}/{key}".lstrip("/")] = parts
        elif len(data.shape) == 1 and data.shape[0] > 1:
            columns.append(dataset_channel(path, key, data, options))
        elif len(data.shape) == 2 and min(data.shape) > 1:
            groups[f"{name}/{key}".lstrip("/")] = _matrix(path, key, data, options)
        elif len(data.shape) == 2 and max(data.shape) > 1:
            columns.append(dataset_channel(path, key, data, options))
    return ({name: columns} if columns else {}) | groups


def dataset_channel(path: Path, name: str, data: "h5py.Dataset", options: TableOptions) -> Channel:
    """Return a dataset of one column, (n,), (n, 1) or (1, n), as a channel."""
    return Channel(name, int(np.prod(data.shape)), partial(_read, path, name, data, options), _unit(data))


def make_reader(
    path: Path, name: str, data: "h5py.Dataset", options: TableOptions, rows: Any
) -> Callable[[], NDArray[Any]]:
    """Return what reads one column, `data[rows]`, of a dataset that is checked first."""

    def read() -> NDArray[Any]:
        check_dataset(path, name, data, options)
        values: NDArray[Any] = data[rows]
        return values

    return read


def _field(path: Path, data: "h5py.Dataset", part: str, options: TableOptions) -> Channel:
    return Channel(part, data.shape[0], make_reader(path, part, data, options, part), _unit(data, part))


def _matrix(path: Path, name: str, data: "h5py.Dataset", options: TableOptions) -> list[Channel]:
    """Return the columns of a matrix (n, k) under the names of its attribute `columns`, else numbered from 1."""
    count = data.shape[1]
    refuse_large(path, count, options.max_cells)
    stored_names = [text(each) for each in np.ravel(data.attrs.get("columns", []))]
    names = stored_names if len(stored_names) == count else [f"{name}_{k + 1}" for k in range(count)]
    readers = [make_reader(path, name, data, options, np.s_[:, k]) for k in range(count)]
    return [Channel(names[k], data.shape[0], readers[k], _unit(data)) for k in range(count)]


def _read(path: Path, name: str, data: "h5py.Dataset", options: TableOptions) -> NDArray[Any]:
    import h5py

    check_dataset(path, name, data, options)
    if h5py.check_string_dtype(data.dtype) is None:
        return np.ravel(data[()])
    texts, length, flat = [], 0, data if len(data.shape) == 1 else np.ravel(data[()])
    for start in range(0, len(flat), TEXT_ROWS):
        part = [text(each) for each in flat[start : start + TEXT_ROWS]]
        length += sum(map(len, part))
        refuse_large(path, length // 8, options.max_cells)
        texts += part
    return np.array(texts, dtype=object)


def check_dataset(path: Path, name: str, data: "h5py.Dataset", options: TableOptions) -> None:
    """Refuse what cannot be read as a column: other files, references, too many cells at once.

    Raises:
        InputError: it lies in another file, holds references, or unpacks to too many cells.
    """
    import h5py

    if data.is_virtual or data.external:
        raise InputError(f"{path}: the samples of {name!r} lie in another file; save all in one file")
    if data.dtype.kind == "O" and h5py.check_string_dtype(data.dtype) is None:
        raise InputError(
            f"{path}: {name!r} holds references or lists where numbers were expected; export it as numbers"
        )
    refuse_large(
        path, max(int(np.prod(part, dtype=object)) for part in (data.shape, data.chunks or (1,))), options.max_cells
    )


def _unit(data: "h5py.Dataset", part: str = "") -> str:
    names = [f"{part}_unit", f"{part}_units"] if part else UNIT_NAMES
    units = [text(data.attrs[name]) for name in names if name in data.attrs]
    return units[0] if units else ""


def text(value: object) -> str:
    """Return a text of an attribute or a cell, which HDF5 gives as bytes, as str or in an array of one."""
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.item()
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _frame_of_pandas(path: Path, name: str, group: "h5py.Group", options: TableOptions) -> Groups:
    """Return a frame that `DataFrame.to_hdf` wrote, empty where the group is none. Nothing is unpickled."""
    if "pandas_type" not in group.attrs:
        return {}
    kind = text(group.attrs["pandas_type"])
    if kind == "frame_table":
        table = group["table"]
        parts = [part for part in table.dtype.names or () if not table.dtype[part].subdtype]
        if len(parts) <= 1:
            raise InputError(
                f"{path}: the names of its columns are stored as a Python pickle, which is not read; write it again by "
                "to_hdf(..., data_columns=True), or as Parquet"
            )
        return {name: [_field(path, table, part, options) for part in parts]}
    if kind != "frame":
        raise InputError(f"{path}: {name!r} is a {kind} of pandas; write a DataFrame, or Parquet")
    columns = [_index_of_pandas(path, group["axis1"], options)]
    for k in range(int(group.attrs["nblocks"])):
        values, items = group[f"block{k}_values"], group[f"block{k}_items"]
        check_dataset(path, "block_items", items, options)
        columns += _named_matrix_channels(path, [text(each) for each in items[:]], values, options)
    return {name: columns}


def _index_of_pandas(path: Path, data: "h5py.Dataset", options: TableOptions) -> Channel:
    kind, stored = text(data.attrs.get("kind", "")), text(data.attrs.get("name", "index"))
    name = stored if stored.isprintable() and stored not in ("", "N.", "None") else "index"

    read_index = make_reader(path, name, data, options, ...)

    def read() -> NDArray[Any]:
        values = read_index()
        if kind.startswith("datetime64"):
            unit = kind.partition("[")[2].rstrip("]") or "ns"
            return values.astype("int64").astype(f"datetime64[{unit}]")
        return values

    return Channel(name, data.shape[0], read)


def _named_matrix_channels(path: Path, names: list[str], data: "h5py.Dataset", options: TableOptions) -> list[Channel]:
    if len(data.shape) != 2 or data.shape[1] != len(names):
        # Text lies in one pickled cell.
        rows = data.shape[0] if data.shape else 0
        problem = "is stored as a Python pickle, which is not read; write it as Parquet"
        return [unreadable_channel(name, f"{path}: column {name!r} {problem}", rows) for name in names]
    return [
        Channel(name, data.shape[0], make_reader(path, name, data, options, np.s_[:, k]))
        for k, name in enumerate(names)
    ]
