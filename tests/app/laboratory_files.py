"""Writers of laboratories' formats for which the environment has no library: .xls, .ods, MATLAB 7.3, frames of pandas.

Written from the formats' descriptions ([MS-XLS], [MS-CFB], OpenDocument 1.3, MathWorks' MAT-file format), for tests.
"""

import math
import struct
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import h5py
import numpy as np
import pandas as pd
import scipy.io
from nptdms import ChannelObject, TdmsWriter
from openpyxl import Workbook

SECTOR = 512


def write_xls(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]]) -> Path:
    """Write numbers and texts as a workbook of Excel 97: BIFF8 records in a compound file of one stream."""
    bofs = [_record(0x809, struct.pack("<HHHHII", 0x600, kind, 0xDBB, 0x7CC, 0, 6)) for kind in (5, 0x10)]
    end = _record(0x0A, b"")
    bodies = [bofs[1] + b"".join(_cells(rows)) + end for rows in sheets.values()]
    names = [_record(0x85, struct.pack("<IBBBB", 0, 0, 0, len(n), 0) + n.encode("latin-1")) for n in sheets]
    starts, position = [], len(bofs[0]) + sum(map(len, names)) + len(end)
    for body in bodies:
        starts.append(position)
        position += len(body)
    placed_records = [
        _record(0x85, struct.pack("<IBBBB", start, 0, 0, len(n), 0) + n.encode("latin-1"))
        for start, n in zip(starts, sheets, strict=True)
    ]
    path.write_bytes(_compound(bofs[0] + b"".join(placed_records) + end + b"".join(bodies)))
    return path


def _record(kind: int, data: bytes) -> bytes:
    return struct.pack("<HH", kind, len(data)) + data


def _cells(rows: Sequence[Sequence[object]]) -> list[bytes]:
    records = []
    for r, row in enumerate(rows):
        for c, cell in enumerate(row):
            if isinstance(cell, str):
                text = struct.pack("<HB", len(cell), 1) + cell.encode("utf-16-le")
                records.append(_record(0x204, struct.pack("<HHH", r, c, 0) + text))
            elif cell is not None:
                records.append(_record(0x203, struct.pack("<HHHd", r, c, 0, float(cell))))
    return records


def _compound(stream: bytes) -> bytes:
    # Streams below 4096 bytes would lie in the small-sector chain, which this writer does not have.
    stream = stream.ljust(4096, b"\0")
    stream += bytes(-len(stream) % SECTOR)
    sectors = len(stream) // SECTOR
    fat_sectors = -(-(sectors + 1) // (SECTOR // 4 - 1))
    chain = [0xFFFFFFFD] * fat_sectors + [0xFFFFFFFE]
    first = fat_sectors + 1
    chain += [first + k + 1 for k in range(sectors - 1)] + [0xFFFFFFFE]
    chain += [0xFFFFFFFF] * (fat_sectors * SECTOR // 4 - len(chain))
    header = bytes.fromhex("D0CF11E0A1B11AE1") + bytes(16) + struct.pack("<HHHHH", 0x3E, 3, 0xFFFE, 9, 6) + bytes(6)
    header += struct.pack("<IIIIIIIII", 0, fat_sectors, fat_sectors, 0, 4096, 0xFFFFFFFE, 0, 0xFFFFFFFE, 0)
    header += b"".join(struct.pack("<I", k if k < fat_sectors else 0xFFFFFFFF) for k in range(109))
    entries = _entry("Root Entry", 5, 0xFFFFFFFE, 0, child=1) + _entry("Workbook", 2, first, len(stream)) + bytes(256)
    return header + struct.pack(f"<{len(chain)}I", *chain) + entries + stream


def _entry(name: str, kind: int, start: int, size: int, child: int = 0xFFFFFFFF) -> bytes:
    text = name.encode("utf-16-le").ljust(64, b"\0")
    header = struct.pack("<HBBIII", 2 * len(name) + 2, kind, 1, 0xFFFFFFFF, 0xFFFFFFFF, child)
    return text + header + bytes(36) + struct.pack("<IQ", start, size)


def write_ods(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]], filler: str = "") -> Path:
    """Write numbers and texts as a document of LibreOffice Calc; `filler` is XML after the last row of each sheet."""
    names = ("office", "table", "text")
    spaces = " ".join(f'xmlns:{n}="urn:oasis:names:tc:opendocument:xmlns:{n}:1.0"' for n in names)
    tables = ""
    for name, rows in sheets.items():
        lines = "".join(f"<table:table-row>{''.join(map(_ods_cell, row))}</table:table-row>" for row in rows)
        tables += f"<table:table table:name={quoteattr(name)}>{lines}{filler}</table:table>"
    body = f"<office:body><office:spreadsheet>{tables}</office:spreadsheet></office:body>"
    kind = "application/vnd.oasis.opendocument.spreadsheet"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mimetype", kind, zipfile.ZIP_STORED)
        content = f'<?xml version="1.0"?><office:document-content {spaces}>{body}</office:document-content>'
        archive.writestr("content.xml", content)
        archive.writestr(
            "META-INF/manifest.xml",
            '<?xml version="1.0"?><manifest:manifest xmlns:manifest='
            '"urn:oasis:names:tc:opendocument:xmlns:manifest:1.0">'
            f'<manifest:file-entry manifest:full-path="/" manifest:media-type="{kind}"/></manifest:manifest>',
        )
    return path


def _ods_cell(cell: object) -> str:
    if cell is None:
        return "<table:table-cell/>"
    if isinstance(cell, str):
        return f'<table:table-cell office:value-type="string"><text:p>{escape(cell)}</text:p></table:table-cell>'
    return (
        f'<table:table-cell office:value-type="float" office:value="{cell}"><text:p>{cell}</text:p></table:table-cell>'
    )


def write_mat73(path: Path, variables: Mapping[str, object]) -> Path:
    """Write vectors, matrices and structs as `save -v7.3` of MATLAB does: HDF5 behind a header of 512 bytes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        _write_mat73(file, variables)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Mon Jan  1 12:00:00 2024 HDF5 schema 1.00 ."
    with path.open("r+b") as raw:
        raw.write(head.ljust(124, b" ") + b"\x00\x02IM")
    return path


def _write_mat73(group: h5py.Group, variables: Mapping[str, object]) -> None:
    for name, value in variables.items():
        if isinstance(value, Mapping):
            inner = group.create_group(name)
            inner.attrs["MATLAB_class"] = np.bytes_("struct")
            _write_mat73(inner, value)
        elif isinstance(value, str):
            data = group.create_dataset(name, data=np.array([[ord(c)] for c in value], np.uint16))
            data.attrs["MATLAB_class"] = np.bytes_("char")
        else:
            array = np.asarray(value)
            array = array[:, None] if array.ndim == 1 else np.atleast_2d(array)
            if array.dtype.kind == "c":
                record = np.zeros(array.shape, [("real", "<f8"), ("imag", "<f8")])
                record["real"], record["imag"], array = array.real, array.imag, record
            data = group.create_dataset(name, data=array.T)
            data.attrs["MATLAB_class"] = np.bytes_("double")


def write_frame_fixed(path: Path, name: str, columns: Mapping[str, Sequence[float]], index_ns: Sequence[int]) -> Path:
    """Write a frame as `DataFrame.to_hdf(format="fixed")` does: one block of floats, an index of times."""
    with h5py.File(path, "w") as file:
        group = file.create_group(name)
        group.attrs.update({"pandas_type": np.bytes_("frame"), "nblocks": 1, "ndim": 2, "encoding": np.bytes_("UTF-8")})
        names = np.array(list(columns), dtype="S")
        group["axis0"], group["block0_items"] = names, names
        axis = group.create_dataset("axis1", data=np.array(index_ns, dtype=np.int64))
        axis.attrs.update({"kind": np.bytes_("datetime64"), "name": np.bytes_("N.")})
        group["block0_values"] = np.array(list(columns.values()), dtype=float).T
    return path


def write_frame_table(path: Path, name: str, columns: Mapping[str, Sequence[float]], has_names: bool = True) -> Path:
    """Write a frame as `DataFrame.to_hdf(format="table")` does, with `data_columns=True` or without."""
    rows = len(next(iter(columns.values())))
    with h5py.File(path, "w") as file:
        group = file.create_group(name)
        group.attrs["pandas_type"] = np.bytes_("frame_table")
        if has_names:
            table = np.zeros(rows, [("index", "<i8"), *((key, "<f8") for key in columns)])
            for key, values in columns.items():
                table[key] = values
        else:
            table = np.zeros(rows, [("index", "<i8"), ("values_block_0", "<f8", (len(columns),))])
            table["values_block_0"] = np.array(list(columns.values())).T
        table["index"] = np.arange(rows)
        group["table"] = table
    return path


ROWS, RATE_HZ = 40, 50.0
T_S = [k / RATE_HZ for k in range(ROWS)]
FORCE = [round(2.1 + 1.9 * math.sin(0.37 * k), 3) for k in range(ROWS)]
OUTPUT = [round(0.27 + 0.061 * force + 0.0009 * (k % 4), 5) for k, force in enumerate(FORCE)]
NAMES = ["t_s", "output", "force"]
SAMPLES = [list(row) for row in zip(T_S, OUTPUT, FORCE, strict=True)]
COLUMNS = {"t_s": T_S, "output": OUTPUT, "force": FORCE}


def write_xlsx(path: Path, sheets: Mapping[str, Sequence[Sequence[object]]]) -> Path:
    """Write a workbook cell by cell."""
    workbook = Workbook()
    workbook.remove(workbook.active)
    for name, rows in sheets.items():
        sheet = workbook.create_sheet(name)
        for row in rows:
            sheet.append(list(row))
    workbook.save(path)
    return path


def write_tdms(path: Path, groups: Mapping[str, Mapping[str, Sequence[float]]], **properties: object) -> Path:
    """Write channels by group, all with the same properties."""
    with TdmsWriter(path) as writer:
        for group, channels in groups.items():
            values = [ChannelObject(group, name, np.array(cells), properties) for name, cells in channels.items()]
            writer.write_segment(values)
    return path


def write_hdf5(path: Path, groups: Mapping[str, Mapping[str, Sequence[float]]]) -> Path:
    """Write datasets by group."""
    with h5py.File(path, "w") as file:
        for group, columns in groups.items():
            for name, cells in columns.items():
                file[f"{group}/{name}"] = np.array(cells)
    return path


def write_corpus(folder: Path) -> None:
    """Write the files of the corpus that are not text; what must be read from them is stated in `BINARY_FILES`."""
    other = {name: [cell + 1 for cell in cells] for name, cells in COLUMNS.items()}
    shifted = [NAMES, *([t, v + 1, f] for t, v, f in SAMPLES)]
    stamps = pd.date_range("2024-05-01 09:30:00", periods=ROWS, freq="20ms").to_pydatetime().tolist()
    with_holes = [None if k in (4, 5) else value for k, value in enumerate(OUTPUT)]
    write_xlsx(folder / "excel.xlsx", {"Sheet1": [NAMES, *SAMPLES]})
    write_xlsx(
        folder / "excel_header_in_row_7.xlsx",
        {"Sheet1": [["Test report"], ["Operator", "Kim"], [], ["Cell", "LC-4"], [], [], NAMES, *SAMPLES]},
    )
    write_xlsx(folder / "excel_units_row.xlsx", {"Sheet1": [["time", "output", "force"], ["s", "V", "N"], *SAMPLES]})
    write_xlsx(folder / "excel_notes_sheet.xlsx", {"Notes": [["pressed by Kim"]], "Data": [NAMES, *SAMPLES]})
    write_xlsx(folder / "excel_two_runs.xlsx", {"Run 1": [NAMES, *SAMPLES], "Run 2": shifted})
    write_xlsx(folder / "excel_second_run.xlsx", {"Run 1": shifted, "Run 2": [NAMES, *SAMPLES]})
    rows = [[stamp, v, f] for stamp, (_, v, f) in zip(stamps, SAMPLES, strict=True)]
    write_xlsx(folder / "excel_dates.xlsx", {"Sheet1": [["Time", "output", "force"], *rows]})
    texts = [[str(cell).replace(".", ",") for cell in row] for row in SAMPLES]
    write_xlsx(folder / "excel_numbers_as_text.xlsx", {"Sheet1": [NAMES, *texts]})
    rows = [[t, f"=C{k + 2}*0.061", f] for k, (t, _, f) in enumerate(SAMPLES)]
    write_xlsx(folder / "excel_formulas_without_values.xlsx", {"Sheet1": [NAMES, *rows]})
    rows = [[t, v, f] for (t, _, f), v in zip(SAMPLES, with_holes, strict=True)]
    write_xlsx(folder / "excel_empty_cells.xlsx", {"Sheet1": [NAMES, *rows, [None, None, None]]})
    rows = [[t, "#N/A" if k == 9 else v, f] for k, (t, v, f) in enumerate(SAMPLES)]
    write_xlsx(folder / "excel_error_cell.xlsx", {"Sheet1": [NAMES, *rows]})
    write_ods(folder / "calc.ods", {"Sheet1": [NAMES, *SAMPLES]})
    write_xls(folder / "excel_97.xls", {"Daten": [NAMES, *SAMPLES]})
    frame = pd.DataFrame(COLUMNS)
    frame.drop(columns="t_s").set_index(pd.DatetimeIndex(stamps)).to_parquet(folder / "pandas_index.parquet")
    frame.assign(output=with_holes).to_parquet(folder / "pandas_nan.parquet", index=False)
    frame.to_feather(folder / "pandas.feather")
    scipy.io.savemat(folder / "matlab_vectors.mat", {**{n: np.array(c) for n, c in COLUMNS.items()}, "fs": RATE_HZ})
    scipy.io.savemat(folder / "matlab_struct.mat", {"run": {n: np.array(c) for n, c in COLUMNS.items()}})
    scipy.io.savemat(folder / "matlab_matrix.mat", {"data": np.array(SAMPLES)})
    write_mat73(folder / "matlab_73.mat", {"run": COLUMNS, "note": "second press"})
    write_hdf5(folder / "h5py.h5", {"run": COLUMNS})
    write_hdf5(folder / "h5py_two_runs.h5", {"run1": COLUMNS, "run2": other})
    channels = {"force": FORCE, "output": OUTPUT}
    write_tdms(
        folder / "labview_wave.tdms", {"Run": channels}, wf_increment=1 / RATE_HZ, wf_start_offset=0.0, wf_samples=ROWS
    )
    write_tdms(folder / "labview_two_groups.tdms", {"Run 1": COLUMNS, "Run 2": other})
    write_tdms(folder / "labview_settings_group.tdms", {"Settings": {"gain": [1.0, 2.0]}, "Run": COLUMNS})


DECLARED = {
    "columns": {"time": "t_s", "output": "output", "reference": "force"},
    "rows": ROWS,
    "rate_Hz": RATE_HZ,
    "duration_s": T_S[-1],
    "missing": 0,
    "output": [OUTPUT[0], OUTPUT[-1]],
    "reference": [FORCE[0], FORCE[-1]],
}
TIME = {**DECLARED["columns"], "time": "Time"}
BINARY_FILES = [
    {**DECLARED, "file": file, **fields}
    for file, fields in {
        "excel.xlsx": {},
        "excel_header_in_row_7.xlsx": {},
        "excel_units_row.xlsx": {"columns": {**TIME, "time": "time"}, "units": {"output": "V", "force": "N"}},
        "excel_notes_sheet.xlsx": {},
        "excel_two_runs.xlsx": {"refused": "'Run 1', 'Run 2'.*--sheet"},
        "excel_second_run.xlsx": {"options": {"sheet": "Run 2"}},
        "excel_dates.xlsx": {"columns": TIME},
        "excel_numbers_as_text.xlsx": {},
        "excel_formulas_without_values.xlsx": {"refused": "B2 is a formula without a stored value"},
        "excel_empty_cells.xlsx": {"missing": 2},
        "excel_error_cell.xlsx": {"missing": 1},
        "calc.ods": {},
        "excel_97.xls": {},
        "pandas_index.parquet": {"columns": {**TIME, "time": "index"}},
        "pandas_nan.parquet": {"missing": 2},
        "pandas.feather": {},
        "matlab_vectors.mat": {},
        "matlab_struct.mat": {},
        "matlab_matrix.mat": {"columns": {"time": "data_1", "output": "data_2", "reference": "data_3"}},
        "matlab_73.mat": {},
        "h5py.h5": {},
        "h5py_two_runs.h5": {"refused": "'run1', 'run2'.*--sheet"},
        "labview_wave.tdms": {},
        "labview_settings_group.tdms": {},
        "labview_two_groups.tdms": {"refused": "'Run 1', 'Run 2'.*--sheet"},
    }.items()
]
"""What must be read from the files of `write_corpus`, as the manifest of the text files states it."""
