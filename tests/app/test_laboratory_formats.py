"""Files of laboratories, written by their own libraries: read with names, units and time, or refused in one line."""

import random
import sys
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from softcal.app.cli.main import main
from softcal.app.tables.options import TableOptions
from softcal.app.tables.read import read_table
from softcal.core.errors import InputError
from tests.app import laboratory_files as written

ROWS = 250
T_S = np.arange(ROWS) / 50
FORCE = 4.0 * np.sin(T_S) ** 2
OUTPUT = 0.3 + 0.1 * FORCE
LARGE = "unpacks to about"


def cells(path, *names, **options):
    """Return the columns of a file by name, those of `names` alone where any are given."""
    table = read_table(path, TableOptions(**options), is_requested=(lambda name: name in names) if names else None)
    return {column.name: column.cells for column in table.columns}


def units(path, **options):
    return {column.name: column.unit for column in read_table(path, TableOptions(**options)).columns}


def write_tdms(path, *channels):
    with TdmsWriter(path) as writer:
        writer.write_segment([ChannelObject(*channel) for channel in channels])
    return path


def write_hdf5(path, datasets):
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name] = values
    return path


def write_any(path: Path) -> Path:
    """Write time, force and output in the format of the suffix."""
    frame = pd.DataFrame({"t_s": T_S, "force_N": FORCE, "output": OUTPUT})
    columns = {name: frame[name].to_numpy() for name in frame}
    rows = [list(frame), *frame.to_numpy().tolist()]
    match path.suffix:
        case ".parquet" | ".pq":
            frame.to_parquet(path, write_page_checksum=True)
        case ".feather":
            frame.to_feather(path)
        case ".arrow":
            table = pa.Table.from_pandas(frame)
            with pa.ipc.new_stream(path, table.schema) as stream:
                stream.write_table(table, max_chunksize=100)
        case ".mat":
            scipy.io.savemat(path, columns, do_compression=True)
        case ".h5" | ".hdf5":
            write_hdf5(path, columns)
        case ".tdms":
            write_tdms(path, *(("run", name, values) for name, values in columns.items()))
        case ".xls":
            written.write_xls(path, {"run": rows})
        case ".ods":
            written.write_ods(path, {"run": rows})
    return path


FORMATS = (".parquet", ".pq", ".feather", ".arrow", ".mat", ".h5", ".hdf5", ".tdms", ".xls", ".ods")


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_gives_the_same_columns(suffix, tmp_path):
    table = cells(write_any(tmp_path / f"S1{suffix}"))
    assert set(table) == {"t_s", "force_N", "output"}
    for name, values in {"t_s": T_S, "force_N": FORCE, "output": OUTPUT}.items():
        np.testing.assert_array_equal(table[name], values)


@pytest.mark.parametrize("suffix", FORMATS)
def test_only_requested_columns_are_returned_and_all_names_are_reported(suffix, tmp_path):
    path = write_any(tmp_path / f"S1{suffix}")
    table = read_table(path, is_requested=lambda name: name in ("t_s", "output"))
    assert {column.name for column in table.columns} == {"t_s", "output"} and len(table.lines) == ROWS
    assert set(table.names) == {"t_s", "force_N", "output"}


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_file_larger_than_allowed_is_refused(suffix, tmp_path):
    path = write_any(tmp_path / f"S1{suffix}")
    with pytest.raises(InputError, match=LARGE):
        read_table(path, TableOptions(max_cells=600))


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_damaged_file_is_one_line_or_still_a_table(suffix, tmp_path):
    draw, whole = random.Random(f"damage {suffix}"), write_any(tmp_path / f"whole{suffix}").read_bytes()
    path, refused = tmp_path / f"S1{suffix}", 0
    for k in range(40):
        content = bytearray(whole[: draw.randrange(8, len(whole))] if k % 2 else whole)
        for _ in range(draw.randrange(1, 20)):
            content[draw.randrange(len(content))] = draw.randrange(256)
        path.write_bytes(content)
        try:
            read_table(path)
        except InputError as error:
            refused += 1
            assert str(path) in str(error) and "\n" not in str(error)
    assert refused >= 10


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_text_with_the_suffix_of_another_format_is_read_as_text(suffix, tmp_path):
    path = tmp_path / f"S1{suffix}"
    path.write_bytes(b"t_s,output\n0,1\n0.02,2\n0.04,3\n")
    table = read_table(path)
    assert table.numbers("output").tolist() == [1, 2, 3]
    assert any("text file, whatever its name says" in remark for remark in table.remarks)


@pytest.mark.parametrize("suffix", [*FORMATS, ".csv", ".jpg", ".zip", ""])
@pytest.mark.parametrize("content", ["zip", "JPEG", "noise", "nothing"])
def test_a_file_of_another_format_is_one_line(content, suffix, tmp_path):
    path, draw = tmp_path / f"S1{suffix}", random.Random(f"{content} {suffix}")
    noise = draw.randbytes(5000)
    begin = {"zip": b"PK\x03\x04", "JPEG": b"\xff\xd8\xff\xe0\x00\x10JFIF\x00", "noise": b"", "nothing": b""}[content]
    path.write_bytes(begin + noise if content != "nothing" else b"")
    with pytest.raises(InputError, match=r"S1.*(export|copy|save|suffix|unpack|is read|empty)") as refusal:
        read_table(path)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("suffix", [".log", ".trc", ""])
def test_a_text_of_any_name_is_read(suffix, tmp_path):
    path = tmp_path / f"S1{suffix}"
    path.write_text("t_s,output\n0,1\n0.02,2\n0.04,3\n")
    assert read_table(path).numbers("output").tolist() == [1, 2, 3]


# Parquet, Feather, Arrow


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_an_index_of_stamps_that_pandas_wrote_is_a_column(suffix, tmp_path):
    stamps = pd.date_range("2024-03-31 01:59:59", periods=4, freq="500ms", tz="Europe/Berlin")
    frame, path = pd.DataFrame({"output": [0.1, None, 0.3, 0.4]}, index=stamps), tmp_path / f"a{suffix}"
    if suffix == ".parquet":
        frame.to_parquet(path)
    else:
        pyarrow.feather.write_feather(pa.Table.from_pandas(frame), path)
    table = cells(path)
    # Berlin leaves winter time between the second and the third stamp: 02:00 is 03:00, in UTC nothing jumps.
    assert [str(stamp)[:21] for stamp in table["index"]] == [
        "2024-03-31T00:59:59.0",
        "2024-03-31T00:59:59.5",
        "2024-03-31T01:00:00.0",
        "2024-03-31T01:00:00.5",
    ]
    np.testing.assert_array_equal(table["output"], [0.1, np.nan, 0.3, 0.4])


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_whole_numbers_decimals_texts_and_truth_values_stay_what_they_are(suffix, tmp_path):
    table = pa.table(
        {
            "count": pa.array([1, None, 3], pa.int32()),
            "mass": pa.array([1, 2, None], pa.decimal128(8, 2)),
            "note": pa.array(["a", None, "b"]),
            "label": pa.array(["x", "x", None]).dictionary_encode(),
            "is_on": pa.array([True, False, None]),
            "span": pa.array([0, 20, 40], pa.duration("ms")),
        }
    ).replace_schema_metadata(None)
    table = table.set_column(0, pa.field("count", pa.int32(), metadata={"unit": "LSB"}), table["count"])
    path = tmp_path / f"a{suffix}"
    write = pyarrow.parquet.write_table if suffix == ".parquet" else pyarrow.feather.write_feather
    write(table, path)
    cells_read = cells(path)
    np.testing.assert_array_equal(cells_read["count"], [1, np.nan, 3])
    np.testing.assert_array_equal(cells_read["mass"], [1, 2, np.nan])
    assert cells_read["note"].tolist() == ["a", None, "b"] and cells_read["label"].tolist() == ["x", "x", None]
    assert cells_read["is_on"].tolist() == [True, False, None]
    assert (cells_read["span"] / np.timedelta64(1, "ms")).tolist() == [0, 20, 40]
    assert units(path)["count"] == "LSB"


def test_a_feather_of_one_value_over_and_over_does_not_unpack(tmp_path):
    path = tmp_path / "bomb.feather"
    pyarrow.feather.write_feather(pa.table({"x": np.zeros(30_000_000)}), path, compression="zstd", chunksize=1 << 26)
    assert path.stat().st_size < 100_000
    with pytest.raises(InputError, match=LARGE):
        read_table(path)


def test_a_page_of_parquet_that_was_changed_is_found_by_its_checksum(tmp_path):
    path = write_any(tmp_path / "a.parquet")
    content = bytearray(path.read_bytes())
    content[len(content) // 4] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_table(path)


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_lists_where_numbers_belong_are_refused_only_where_they_are_asked_for(suffix, tmp_path):
    table, path = pa.table({"output": [1.0, 2.0], "spectrum": [[1.0], [2.0]]}), tmp_path / f"a{suffix}"
    (pyarrow.parquet.write_table if suffix == ".parquet" else pyarrow.feather.write_feather)(table, path)
    assert cells(path, "output")["output"].tolist() == [1, 2]
    with pytest.raises(InputError, match=r"'spectrum'.*list"):
        read_table(path)


@pytest.mark.parametrize("suffix", [".parquet", ".mat", ".h5"])
def test_unix_stamps_in_ns_are_read_and_counts_that_floats_cannot_tell_apart_are_refused(suffix, tmp_path):
    stamps, counts = 1_700_000_000_000_000_000 + 20_000_000 * np.arange(9), 2**60 + np.arange(9)
    path = tmp_path / f"a{suffix}"
    for values, is_read in ((stamps, True), (counts, False)):
        columns = {"n": values, "output": np.arange(9.0)}
        if suffix == ".parquet":
            pd.DataFrame(columns).to_parquet(path)
        elif suffix == ".mat":
            scipy.io.savemat(path, columns)
        else:
            write_hdf5(path, columns)
        if is_read:
            np.testing.assert_allclose(np.diff(cells(path)["n"]), 2e7, atol=512)
        else:
            with pytest.raises(InputError, match=r"'n'.*2\^53"):
                read_table(path)


# MATLAB

MATLAB_FILES = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"


@pytest.mark.parametrize("release", ["4.2c_SOL2", "6.1_SOL2", "6.5.1_GLNX86", "7.1_GLNX86", "7.4_GLNX86"])
def test_a_vector_that_matlab_itself_saved(release):
    # SciPy's documented content of these files: 0 to 2 pi in steps of pi/4.
    path = MATLAB_FILES / f"testdouble_{release}.mat"
    np.testing.assert_allclose(cells(path)["testdouble"], np.arange(9) * np.pi / 4)


def test_a_hdf5_file_that_matlab_itself_saved():
    path = MATLAB_FILES / "testhdf5_7.4_GLNX86.mat"
    np.testing.assert_allclose(cells(path)["testdouble"], np.arange(9) * np.pi / 4)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_vectors_structs_and_matrices_of_matlab(version, tmp_path):
    path = tmp_path / "a.mat"
    content = {"t": T_S, "F": FORCE, "fs": 50.0, "who": "Kim", "run": {"t": T_S, "out": OUTPUT}, "m": np.c_[T_S, FORCE]}
    write = scipy.io.savemat if version == "5" else written.write_mat73
    write(path, content)
    table = cells(path, sheet="workspace")
    assert set(table) == {"t", "F"}
    np.testing.assert_array_equal(table["F"], FORCE)
    np.testing.assert_array_equal(cells(path, sheet="run")["out"], OUTPUT)
    np.testing.assert_array_equal(cells(path, sheet="m")["m_2"], FORCE)
    # Only one variable has what is asked for
    np.testing.assert_array_equal(cells(path, "out")["out"], OUTPUT)
    with pytest.raises(InputError, match=r"'workspace', .*'run'.*--sheet"):
        read_table(path)
    with pytest.raises(InputError, match=r"no variable 'gone'.*'run'.*--sheet"):
        read_table(path, TableOptions(sheet="gone"))


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_complex_numbers_of_matlab_are_refused_by_name(version, tmp_path):
    path = tmp_path / "a.mat"
    (scipy.io.savemat if version == "5" else written.write_mat73)(path, {"t": T_S, "z": OUTPUT + 1j})
    np.testing.assert_array_equal(cells(path, "t")["t"], T_S)
    with pytest.raises(InputError, match="'z' holds complex numbers"):
        read_table(path)


def test_a_structure_with_time_as_simulink_logs_it(tmp_path):
    signals = np.zeros(2, dtype=[("values", object), ("label", object)])
    signals[0], signals[1] = (FORCE[:, None], "force"), (OUTPUT[:, None], "output")
    scipy.io.savemat(tmp_path / "a.mat", {"logged": {"time": T_S[:, None], "signals": signals}})
    table = cells(tmp_path / "a.mat")
    np.testing.assert_array_equal(table["time"], T_S)
    np.testing.assert_array_equal(table["output"], OUTPUT)


def test_an_array_of_structs_is_a_row_each(tmp_path):
    records = np.zeros(3, dtype=[("t", object), ("F", object)])
    for k in range(3):
        records[k] = (k / 50, 2.0 * k)
    scipy.io.savemat(tmp_path / "a.mat", {"log": records})
    np.testing.assert_array_equal(cells(tmp_path / "a.mat")["F"], [0, 2, 4])


MATLAB_OBJECTS = [
    (
        "timeseries",
        r"'X' is a timeseries of MATLAB.*in MATLAB: t = X\.Time; y = X\.Data; save\('a_vectors\.mat', 't', 'y'\)",
    ),
    ("table", r"'X' is a table of MATLAB.*in MATLAB: writetable\(X, 'a\.csv'\)"),
    ("timetable", r"'X' is a timetable of MATLAB.*in MATLAB: writetimetable\(X, 'a\.csv'\)"),
    ("string", "'X' is a string of MATLAB.*its parts as vectors"),
]


def write_object_73(path, kind, **others):
    written.write_mat73(path, {"X": [1.0, 2.0], "#subsystem#": {"MCOS": [1.0, 2.0]}, **others})
    with h5py.File(path, "r+") as file:
        file["X"].attrs["MATLAB_object_decode"] = np.int32(3)
        file["X"].attrs["MATLAB_class"] = np.bytes_(kind)


def read_object_5(monkeypatch, path, kind, **others):
    """Let SciPy return what it does of a file of version 5 with an object; it writes none itself."""
    scipy.io.savemat(path, {"gain": 1.0})
    fields = [(name, object) for name in ("s0", "s1", "s2", "arr")]
    opaque = np.array([(b"X", b"MCOS", kind.encode(), np.zeros((6, 1), np.uint32))], fields)
    variables = {"None": scipy.io.matlab.MatlabOpaque(opaque), "__function_workspace__": np.zeros((1, 8), np.uint8)}
    variables |= {name: np.atleast_2d(values).T for name, values in others.items()}
    monkeypatch.setattr(scipy.io, "loadmat", lambda *_, **__: variables)


@pytest.mark.parametrize("version", ["5", "7.3"])
@pytest.mark.parametrize(("kind", "line"), MATLAB_OBJECTS)
def test_an_object_that_only_matlab_can_open_is_named_with_the_cure(kind, line, version, monkeypatch, tmp_path):
    path = tmp_path / "a.mat"

    def write(**others):
        if version == "7.3":
            write_object_73(path, kind, **others)
        else:
            read_object_5(monkeypatch, path, kind, **others)

    write()
    for is_requested in (None, lambda name: name == "output", lambda name: name == "X"):
        with pytest.raises(InputError, match=line):
            read_table(path, is_requested=is_requested)
    # Beside vectors it is in nobody's way.
    write(t=T_S, output=OUTPUT)
    np.testing.assert_array_equal(cells(path, "t", "output")["output"], OUTPUT)
    for options, is_requested in ((TableOptions(sheet="X"), None), (TableOptions(), lambda name: name == "X")):
        with pytest.raises(InputError, match=line):
            read_table(path, options, is_requested=is_requested)


def test_a_matrix_of_zeros_that_matlab_packed_does_not_unpack(tmp_path):
    path = tmp_path / "bomb.mat"
    scipy.io.savemat(path, {"run": {"x": np.zeros(30_000_000)}}, do_compression=True)
    assert path.stat().st_size < 300_000
    with pytest.raises(InputError, match=LARGE):
        read_table(path)


# HDF5


def test_a_group_of_datasets_with_their_units(tmp_path):
    path = write_hdf5(tmp_path / "a.h5", {"run/t_s": T_S, "run/force": FORCE, "run/gain": [1.0, 2.0], "version": 3})
    with h5py.File(path, "r+") as file:
        file["run/force"].attrs["units"] = "N"
    table = read_table(path)
    assert units(path) == {"t_s": "", "force": "N"}
    assert any("'gain' (2)" in remark for remark in table.remarks)
    with pytest.raises(InputError, match=r"'gain' \(2\)"):
        cells(path, "t_s", "gain")


def test_a_compound_dataset_is_a_table(tmp_path):
    records = np.zeros(ROWS, [("t", "<f8"), ("count", "<i4"), ("note", "S4")])
    records["t"], records["count"], records["note"] = T_S, np.arange(ROWS), b"ok"
    table = cells(write_hdf5(tmp_path / "a.h5", {"log": records}))
    assert table["count"][-1] == ROWS - 1 and table["note"][0] == "ok"


def test_groups_that_hold_samples_are_asked_about(tmp_path):
    path = write_hdf5(tmp_path / "a.h5", {"A/x": T_S, "B/deep/x": FORCE})
    np.testing.assert_array_equal(cells(path, sheet="B/deep")["x"], FORCE)
    with pytest.raises(InputError, match=r"'A', 'B/deep'.*--sheet"):
        cells(path, "x")


def test_frames_that_pandas_wrote(tmp_path):
    columns = {"force": FORCE, "output": OUTPUT}
    start_ns, step_ns = 1_700_000_000_000_000_000, 20_000_000
    fixed = written.write_frame_fixed(tmp_path / "f.h5", "run", columns, start_ns + step_ns * np.arange(ROWS))
    table = cells(fixed)
    np.testing.assert_array_equal(table["output"], OUTPUT)
    assert str(table["index"][1])[:22] == "2023-11-14T22:13:20.02"
    np.testing.assert_array_equal(cells(written.write_frame_table(tmp_path / "t.h5", "run", columns))["force"], FORCE)
    with pytest.raises(InputError, match=r"pickle.*data_columns=True"):
        read_table(written.write_frame_table(tmp_path / "p.h5", "run", columns, has_names=False))


def test_no_other_file_is_opened_through_hdf5(tmp_path):
    other = write_hdf5(tmp_path / "other.h5", {"x": T_S})
    layout = h5py.VirtualLayout(shape=(ROWS,), dtype="f8")
    layout[:] = h5py.VirtualSource(str(other), "/x", shape=(ROWS,))
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("raw", (4,), dtype="f8", external=[(str(tmp_path / "other.h5"), 0, 32)])
        file.create_dataset("pointers", data=np.array([file["raw"].ref] * 4, dtype=h5py.ref_dtype))
    for name, problem in (("virtual", "another file"), ("raw", "another file"), ("pointers", "references")):
        with pytest.raises(InputError, match=problem):
            cells(path, name)
    with h5py.File(path, "w") as file:
        file["link"] = h5py.ExternalLink(str(other), "/x")
    with pytest.raises(InputError, match="another file"):
        read_table(path)


def test_groups_that_contain_themselves_end(tmp_path):
    path = write_hdf5(tmp_path / "a.h5", {"x": T_S})
    with h5py.File(path, "r+") as file:
        file["again"], file["soft"] = file["/"], h5py.SoftLink("/")
    np.testing.assert_array_equal(cells(path)["x"], T_S)


def test_a_dataset_that_claims_a_terabyte_is_not_read(tmp_path):
    path = tmp_path / "bomb.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", (10**12,), chunks=(1000,), dtype="f8", compression="gzip")
    with pytest.raises(InputError, match=LARGE):
        read_table(path)


# TDMS


def test_a_waveform_has_its_time_and_unit_from_its_properties(tmp_path):
    wave = {"wf_increment": 0.02, "wf_start_offset": 1.5, "wf_samples": ROWS}
    channels = [("run", "force", FORCE, wave | {"unit_string": "N"}), ("run", "count", np.arange(ROWS), wave)]
    path = write_tdms(tmp_path / "a.tdms", *channels)
    np.testing.assert_allclose(cells(path)["t_s"], 1.5 + T_S)
    assert units(path) == {"force": "N", "count": "", "t_s": "s"}


def test_a_channel_of_time_is_kept_beside_a_waveform(tmp_path):
    wave = {"wf_increment": 0.05, "wf_start_offset": 0.0, "wf_samples": ROWS}
    path = write_tdms(tmp_path / "a.tdms", ("run", "t_s", T_S), ("run", "force", FORCE, wave))
    np.testing.assert_array_equal(cells(path)["t_s"], T_S)


def test_stamps_of_labview_are_stamps(tmp_path):
    stamps = np.datetime64("2024-05-01T10:00:00", "us") + np.arange(ROWS) * np.timedelta64(20, "ms")
    path = write_tdms(tmp_path / "a.tdms", ("run", "Time", stamps), ("run", "force", FORCE), ("run", "s", ["x"] * ROWS))
    table = cells(path)
    assert table["Time"].dtype == "datetime64[ns]" and str(table["Time"][-1])[:23] == "2024-05-01T10:00:04.980"
    assert table["s"][0] == "x"


def test_channels_of_two_rates_are_not_put_side_by_side(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", ("run", "fast", FORCE), ("run", "slow", FORCE[::5]))
    assert set(cells(path)) == {"fast"}
    with pytest.raises(InputError, match=r"'slow' \(50\) samples.*250"):
        cells(path, "fast", "slow")
    waves = [{"wf_increment": step_s, "wf_samples": ROWS} for step_s in (0.02, 0.04)]
    path = write_tdms(tmp_path / "b.tdms", *(("run", f"c{k}", FORCE, wave) for k, wave in enumerate(waves)))
    with pytest.raises(InputError, match="different steps"):
        cells(path, "c0", "t_s")


def test_a_tdms_file_that_ends_early_says_so(tmp_path, capfd):
    path = write_any(tmp_path / "a.tdms")
    assert not read_table(path).remarks
    path.write_bytes(path.read_bytes()[:-80])
    table = read_table(path, is_requested=lambda name: name == "force_N")
    assert len(table.lines) == ROWS and "ends early" in table.remarks[0]
    with pytest.raises(InputError, match=r"'output' \(240\) samples"):
        read_table(path, is_requested=lambda name: name in ("force_N", "output"))
    assert not capfd.readouterr().err


def test_runs_of_one_tdms_file_are_asked_about(tmp_path):
    path = write_tdms(tmp_path / "a.tdms", ("run 1", "force", FORCE), ("run 2", "force", OUTPUT))
    np.testing.assert_array_equal(cells(path, sheet="run 2")["force"], OUTPUT)
    with pytest.raises(InputError, match=r"'run 1', 'run 2'.*--sheet"):
        read_table(path)


# .xls, .ods

TABLE = [["t_s", "force_N"], *([k / 50, k * 1.5] for k in range(30))]


@pytest.mark.parametrize("suffix", [".xls", ".ods"])
def test_a_second_sheet_is_asked_about(suffix, tmp_path):
    write, path = getattr(written, f"write_{suffix[1:]}"), tmp_path / f"a{suffix}"
    write(path, {"first": TABLE, "second": [["t_s", "force_N"], [0.0, 7.0], [0.5, 8.0]]})
    assert cells(path, sheet="second")["force_N"].tolist() == [7, 8]
    with pytest.raises(InputError, match=r"'first', 'second'.*--sheet"):
        read_table(path)
    with pytest.raises(InputError, match=r"no sheet 'third'.*'first', 'second'"):
        read_table(path, TableOptions(sheet="third"))
    write(path, {"first": TABLE, "empty": []})
    assert len(cells(path)["force_N"]) == 30


def test_rows_of_an_ods_that_are_only_formatted_do_not_count(tmp_path):
    filler = (
        '<table:table-row table:number-rows-repeated="1048545"><table:table-cell table:number-columns-repeated="1024"/>'
    )
    path = written.write_ods(tmp_path / "a.ods", {"run": TABLE}, filler + "</table:table-row>")
    assert len(cells(path)["force_N"]) == 30


@pytest.mark.parametrize(
    "row",
    [
        '<table:table-row table:number-rows-repeated="1000000">{cell}</table:table-row>',
        '<table:table-row table:number-rows-repeated="1000000"/><table:table-row>{cell}</table:table-row>',
        '<table:table-row><table:table-cell table:number-columns-repeated="9000000"/>{cell}</table:table-row>',
    ],
)
def test_an_ods_whose_cells_stand_far_out_or_repeat_is_refused(row, tmp_path):
    cell = '<table:table-cell office:value-type="float" office:value="1" table:number-columns-repeated="16384"/>'
    path = written.write_ods(tmp_path / "bomb.ods", {"run": TABLE}, row.format(cell=cell))
    with pytest.raises(InputError, match=LARGE):
        read_table(path)


def test_output_and_reference_in_two_groups_are_said_to_be(tmp_path):
    path = write_tdms(tmp_path / "S1.tdms", ("Sensor", "output", OUTPUT), ("Load cell", "force", FORCE))
    with pytest.raises(InputError, match="'output' in 'Sensor'.*'force' in 'Load cell'|'force'.*'output' in 'Sensor'"):
        read_table(path, is_requested={"output", "force"}.__contains__)
    assert len(read_table(path, is_requested={"output"}.__contains__)) == len(OUTPUT)


def test_a_group_is_read_that_alone_has_all_requested_columns(tmp_path):
    parts = [("Run", "t_s", T_S), ("Run", "output", OUTPUT), ("Room", "t_s", T_S), ("Room", "temperature", FORCE)]
    path = write_tdms(tmp_path / "S1.tdms", *parts)
    assert len(read_table(path, is_requested={"t_s", "output"}.__contains__)) == len(OUTPUT)


@pytest.mark.parametrize(
    ("module", "file"),
    [
        ("h5py", "h5py.h5"),
        ("h5py", "matlab_73.mat"),
        ("nptdms", "labview_wave.tdms"),
        ("python_calamine", "calc.ods"),
        ("python_calamine", "excel_97.xls"),
    ],
)
def test_a_format_whose_library_is_missing_names_the_extra_that_brings_it(
    module, file, monkeypatch, tmp_path, capsys
) -> None:
    written.write_corpus(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    assert main(["inspect", str(tmp_path / file), "--output-column", "output"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert file in line and f"this needs {module}, " in line and line.endswith("pip install 'softcal[formats]'")
