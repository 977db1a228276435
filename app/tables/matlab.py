"""MATLAB's .mat files: vectors, structs of vectors, matrices; of version 5 (scipy) and 7.3 (HDF5)."""

import struct
import zlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
import scipy
from numpy.typing import NDArray

from softcal.app.tables.arrays import Channel, choose_group, read_channels, refuse_large, unreadable_channel
from softcal.app.tables.hdf5 import dataset_channel, make_reader, members, text
from softcal.app.tables.headings import IsRequested
from softcal.app.tables.options import TableOptions
from softcal.app.tables.table import Table
from softcal.core.errors import InputError

if TYPE_CHECKING:
    import h5py

WORKSPACE = "workspace"
"""Name of the table that the vectors beside each other make."""

HEADER_BYTES, COMPRESSED = 128, 15
BYTES_AT_ONCE = 1 << 20
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
CURES = {
    "timeseries": "t = {name}.Time; y = {name}.Data; save('{stem}_vectors.mat', 't', 'y')",
    "table": "writetable({name}, '{stem}.csv')",
    "timetable": "writetimetable({name}, '{stem}.csv')",
}
"""What makes a readable file of an object, in MATLAB, by its class."""

Groups = dict[str, list[Channel]]


def read_matlab(file: BinaryIO, path: Path, options: TableOptions, is_requested: IsRequested) -> Table:
    """Return the requested columns of the declared variable, or of the variable with samples.

    Raises:
        InputError: several variables hold samples and none is declared, an object that only MATLAB can open, or too
            many cells.
    """
    start = file.read(520)
    file.seek(0)
    if HDF5_MAGIC in start:
        import h5py

        with h5py.File(file, "r") as hdf5_file:
            return _read_group(path, _groups_of_hdf5(path, hdf5_file, options), options, is_requested)
    _check_size(file, path, options)
    variables = scipy.io.loadmat(file, chars_as_strings=True, struct_as_record=True, appendmat=False)
    return _read_group(path, _groups_of_variables(path, variables), options, is_requested)


def _read_group(path: Path, groups: Groups, options: TableOptions, is_requested: IsRequested) -> Table:
    channels = [channel for group in groups.values() for channel in group]
    objects = [channel for channel in channels if not channel.rows]
    for channel in objects:
        # Nothing else is there, or it is what was asked for: reading it says why it cannot be read.
        if len(objects) == len(channels) or channel.name == options.sheet:
            channel.read()
    name = choose_group(path, groups, options, is_requested, "variable")
    layout = "" if name == WORKSPACE else f"variable {name!r}"
    return read_channels(path, groups[name], options, is_requested, layout)


def _check_size(file: BinaryIO, path: Path, options: TableOptions) -> None:
    """Refuse a file whose compressed variables unpack to more than is allowed; leave the file at its start."""
    content = file.read()
    file.seek(0)
    order = ">" if content[126:128] == b"MI" else "<"
    position, size = HEADER_BYTES, len(content)
    while position + 8 <= len(content) and content[124:128].strip(b"\0"):
        kind, length = struct.unpack_from(f"{order}II", content, position)
        if kind == COMPRESSED:
            unpacker, remaining = zlib.decompressobj(), content[position + 8 : position + 8 + length]
            while remaining and not unpacker.eof:
                size += len(unpacker.decompress(remaining, BYTES_AT_ONCE))
                remaining = unpacker.unconsumed_tail
                refuse_large(path, size // 8, options.max_cells)
        position += 8 + length
    refuse_large(path, size // 8, options.max_cells)


def _groups_of_variables(path: Path, variables: Mapping[str, Any]) -> Groups:
    groups: Groups = {}
    workspace: list[Channel] = []
    for name, value in variables.items():
        if type(value).__name__ == "MatlabOpaque":
            workspace.append(_object(path, text(value["s0"].flat[0]) or name, text(value["s2"].flat[0])))
        elif name.startswith("__") or type(value).__name__ == "MatlabFunction":
            continue
        elif scipy.sparse.issparse(value):
            groups[name] = [_unreadable_channel(path, name, "is a sparse matrix; save it as a full one: full(x)")]
        elif value.dtype.names:
            groups |= _structs(path, name, value)
        elif _is_vector(value):
            workspace.append(_vector(name, value))
        elif _is_matrix(value):
            groups[name] = _matrix(name, value)
    return ({WORKSPACE: workspace} if workspace else {}) | groups


def _structs(path: Path, name: str, value: NDArray[Any]) -> Groups:
    """Return the vectors of a struct; of one with `time` and `signals`, as Simulink writes, their values."""
    if value.size != 1:
        return {name: _records(name, value)}
    fields = {key: value.flat[0][key] for key in value.dtype.names or ()}
    if {"time", "signals"} <= fields.keys() and fields["signals"].dtype.names:
        return {name: _simulink(fields)}
    columns: list[Channel] = []
    groups: Groups = {}
    for key, part in fields.items():
        if type(part).__name__ == "MatlabOpaque":
            columns.append(_object(path, f"{name}.{key}", text(part["s2"].flat[0])))
        elif part.dtype.names:
            groups |= {
                f"{name}.{inner.partition('.')[2] or key}": channels
                for inner, channels in _structs(path, key, part).items()
            }
        elif _is_vector(part):
            columns.append(_vector(key, part))
        elif _is_matrix(part):
            columns += _matrix(key, part)
    return ({name: columns} if columns else {}) | groups


def _records(name: str, value: NDArray[Any]) -> list[Channel]:
    """Return the fields of an array of structs, one struct a sample, as columns."""

    def read(key: str) -> NDArray[Any]:
        cells = [np.ravel(cell) for cell in np.ravel(value[key])]
        if any(len(cell) > 1 for cell in cells):
            raise InputError(f"field {key!r} of {name!r} holds more than one number a sample; save it as a matrix")
        return np.array([cell[0] if len(cell) else np.nan for cell in cells])

    return [Channel(key, value.size, partial(read, key)) for key in value.dtype.names or ()]


def _simulink(fields: Mapping[str, NDArray[Any]]) -> list[Channel]:
    columns = [_vector("time", fields["time"])]
    for k, signal in enumerate(fields["signals"].flat):
        label = str(signal["label"].item()) if "label" in signal.dtype.names and signal["label"].size == 1 else ""
        values = signal["values"]
        name = label or f"signal_{k + 1}"
        columns += [_vector(name, values)] if _is_vector(values) else _matrix(name, values)
    return columns


def _unreadable_channel(path: Path, name: str, problem: str) -> Channel:
    return unreadable_channel(name, f"{path}: {name!r} {problem}")


def _object(path: Path, name: str, kind: str) -> Channel:
    """Return a variable that only MATLAB can open, with the MATLAB call that converts it."""
    cure = CURES.get(kind, "save('{stem}_vectors.mat', ...) of its parts as vectors").format(name=name, stem=path.stem)
    return _unreadable_channel(
        path,
        name,
        f"is {f'a {kind}' if kind else 'an object'} of MATLAB, which only MATLAB can open; in MATLAB: {cure}",
    )


def _is_vector(value: NDArray[Any]) -> bool:
    is_text = value.dtype.kind in "US"
    return value.size > 1 and max(value.shape) == value.size and (value.dtype.kind in "buifc" or is_text)


def _is_matrix(value: NDArray[Any]) -> bool:
    return value.ndim == 2 and min(value.shape) > 1 and value.dtype.kind in "uifc"


def _vector(name: str, value: NDArray[Any]) -> Channel:
    return Channel(name, value.size, value.ravel)


def _matrix(name: str, value: NDArray[Any]) -> list[Channel]:
    return [Channel(f"{name}_{k + 1}", len(value), value[:, k].copy) for k in range(value.shape[1])]


def _groups_of_hdf5(path: Path, root: "h5py.Group", options: TableOptions) -> Groups:
    import h5py

    workspace, groups = _columns_of_hdf5(path, root, options)
    for name in members(path, root, h5py.Group):
        if not name.startswith("#"):
            columns, matrices = _columns_of_hdf5(path, root[name], options)
            groups |= {name: columns} if columns else {}
            groups |= {f"{name}.{key}": matrix for key, matrix in matrices.items()}
    return ({WORKSPACE: workspace} if workspace else {}) | groups


def _columns_of_hdf5(path: Path, group: "h5py.Group", options: TableOptions) -> tuple[list[Channel], Groups]:
    """Return the vectors of a group and, apart, its matrices; HDF5 holds MATLAB's columns as rows."""
    import h5py

    columns: list[Channel] = []
    matrices: Groups = {}
    for name in members(path, group, h5py.Dataset):
        data = group[name]
        kind = text(data.attrs.get("MATLAB_class", ""))
        if "MATLAB_object_decode" in data.attrs:
            columns.append(_object(path, name, kind))
        elif kind in ("char", "cell") or "MATLAB_empty" in data.attrs or data.size is None or data.size < 2:
            continue
        elif max(data.shape) == data.size:
            channel = dataset_channel(path, name, data, options)
            columns.append(Channel(name, channel.rows, partial(_real, channel), channel.unit))
        elif len(data.shape) == 2:
            matrices[name] = _matrix_of_hdf5(path, name, data, options)
    return columns, matrices


def _real(channel: Channel) -> NDArray[Any]:
    """Return the samples; complex ones, which MATLAB stores as records of `real` and `imag`, as complex numbers."""
    values = channel.read()
    if values.dtype.names == ("real", "imag"):
        complexes: NDArray[Any] = values["real"] + 1j * values["imag"]
        return complexes
    return values


def _matrix_of_hdf5(path: Path, name: str, data: "h5py.Dataset", options: TableOptions) -> list[Channel]:
    count, rows = data.shape
    refuse_large(path, count, options.max_cells)
    return [Channel(f"{name}_{k + 1}", rows, make_reader(path, name, data, options, k)) for k in range(count)]
