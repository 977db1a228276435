"""Files as loggers write them, drawn by the thousand: taken right, refused with a cure that helps, or silently wrong.

    python benchmarks/logger_files.py [--files 1500] [--seed 1] [--show 3] [--keep FOLDER]

Every file is drawn: format, delimiter, decimal mark, encoding, preamble, header, units, kind of time, and at most one
fault. Its numbers are drawn first, so that what must come out of it is certain. A file that is refused is read again
with what its line asks for (`--decimal ,`); that cure is right if the file then reads as drawn, or, where no option can
help, if the line names the place and the kind of the fault. Exit code 1 if a file was read wrong without a word.
"""

import argparse
import random
import re
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from common.tables import print_table

from softcal.app.files.recording_file import ColumnNames, FileRecording, inspect_recording
from softcal.app.tables.options import TableOptions
from softcal.core.errors import InputError

RIGHT, CURED, WRONG_CURE, SILENT = "taken right", "refused, right cure", "refused, wrong cure", "silent and wrong"
OUTCOMES = (RIGHT, CURED, WRONG_CURE, SILENT)
BINARY = (".xlsx", ".parquet", ".feather", ".mat", ".h5", ".tdms")
RATES_HZ = (10, 20, 25, 50, 100, 200, 250, 500, 1000)
OPTIONS = (
    "delimiter",
    "decimal",
    "encoding",
    "header-row",
    "sheet",
    "time-format",
    "missing",
    "sample-rate",
    "time-column",
)
MAX_TRIES = 5
EPOCH = datetime(2024, 5, 14, 23, 59, 58)  # noqa: DTZ001 - loggers state no zone


@dataclass
class Draft:
    """One drawn file: what stands in it and what must be read from it.

    Args:
        t_s, output, reference: (n,) what must be read; NaN where a sample is missing; rows that are lost are left out.
        names: headings of time, output and reference.
        truth: value of each option that states how the file is laid out.
        given: options that the person declares from the beginning.
        blamed: what the refusal of a fault that no option cures must hold, a regular expression.
        kinds: what was drawn, for the shares by kind.
    """

    t_s: Any
    output: Any
    reference: Any
    names: dict[str, str]
    truth: dict[str, Any] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)
    blamed: str = ""
    kinds: dict[str, str] = field(default_factory=dict)
    content: bytes = b""
    suffix: str = ".csv"


def draw(rng: random.Random) -> Draft:
    """Draw one file."""
    rate_Hz, n = rng.choice(RATES_HZ), rng.randrange(60, 400)
    k = np.arange(n)
    force = np.round(rng.uniform(1, 20) * np.sin(k / rng.uniform(8, 30)) ** 2, rng.choice((2, 3, 4)))
    scale = 10.0 ** rng.choice((-3, 0, 0, 2))
    output = np.array([float(f"{x:.6g}") for x in scale * (0.3 + 0.04 * force + 0.003 * np.sin(k * 1.7))])
    draft = Draft(k / rate_Hz, output, force, {"output": rng.choice(OUTPUTS), "reference": rng.choice(REFERENCES)})
    if rng.random() < 0.12:
        return draw_binary(rng, draft, rate_Hz)
    return draw_text(rng, draft, rate_Hz)


OUTPUTS = ("output", "Voltage", "V out", "CH1", "raw", "Ausgang", "sensor_V", "Signal (V)")
REFERENCES = ("force", "Load", "Force (N)", "Kraft", "reference", "CH2", "Last [N]")


def draw_binary(rng: random.Random, draft: Draft, rate_Hz: float) -> Draft:
    """Write a drawn file in a format of laboratories."""
    import pandas as pd

    draft.suffix, draft.names["time"] = rng.choice(BINARY), rng.choice(("t_s", "Time (s)", "time_ms"))
    factor = 1000 if draft.names["time"] == "time_ms" else 1
    if rng.random() < 0.4:
        draft.output[rng.sample(range(len(draft.output)), 3)] = np.nan
    columns = {
        draft.names["time"]: draft.t_s * factor,
        draft.names["output"]: draft.output,
        draft.names["reference"]: draft.reference,
    }
    draft.kinds = {"format": draft.suffix, "time": draft.names["time"], "fault": "none", "layout": "plain"}
    draft.given["time-column"] = draft.truth["time-column"] = draft.names["time"]
    with tempfile.TemporaryDirectory() as folder:
        path, frame = Path(folder) / f"a{draft.suffix}", pd.DataFrame(columns)
        match draft.suffix:
            case ".xlsx":
                top = rng.choice((0, 0, 3))
                draft.kinds["layout"] = "rows above the header" if top else "plain"
                frame.to_excel(path, index=False, startrow=top)
            case ".parquet":
                frame.to_parquet(path)
            case ".feather":
                frame.to_feather(path)
            case ".mat":
                import scipy.io

                columns = {re.sub(r"\W", "_", name): values for name, values in columns.items()}
                draft.names = {role: re.sub(r"\W", "_", name) for role, name in draft.names.items()}
                draft.given["time-column"] = draft.truth["time-column"] = draft.names["time"]
                scipy.io.savemat(path, columns if rng.random() < 0.5 else {"run": columns})
            case ".h5":
                import h5py

                with h5py.File(path, "w") as file:
                    for name, values in columns.items():
                        file[f"run/{name}"] = values
            case ".tdms":
                from nptdms import ChannelObject, TdmsWriter

                with TdmsWriter(path) as writer:
                    writer.write_segment([ChannelObject("run", name, values) for name, values in columns.items()])
        draft.content = path.read_bytes()
    return draft


def draw_text(rng: random.Random, draft: Draft, rate_Hz: float) -> Draft:
    """Write a drawn file as text."""
    decimal = rng.choices((".", ","), (0.72, 0.28))[0]
    delimiters = (",", "\t", ";", "blanks", "|") if decimal == "." else (";", "\t", "blanks", '","')
    delimiter = rng.choices(delimiters, (0.5, 0.2, 0.12, 0.12, 0.06)[: len(delimiters)])[0]
    draft.truth |= {"delimiter": "," if delimiter == '","' else delimiter, "decimal": decimal}
    is_quoted = delimiter == '","' or (delimiter in ",;" and rng.random() < 0.15)
    number = lambda x: f"{x:.10g}".replace(".", decimal)  # noqa: E731
    cells_of_time, name, kind = draw_time(rng, draft, rate_Hz, number, decimal)
    if delimiter == "blanks" and any(" " in cell for cell in cells_of_time):
        cells_of_time, name, kind = [number(t) for t in draft.t_s], "t_s", "s"
        draft.truth.pop("time-format", None)
    if delimiter == "blanks":
        draft.names = {role: re.sub(r"\W+", "_", text).strip("_") for role, text in draft.names.items()}
        name = re.sub(r"\W+", "_", name).strip("_")
    rows = [
        [*([cells_of_time[k]] if name else []), number(draft.output[k]), number(draft.reference[k])]
        for k in range(len(draft.t_s))
    ]
    header = [*([name] if name else []), draft.names["output"], draft.names["reference"]]
    if name:
        draft.names["time"] = draft.truth["time-column"] = name
        if rng.random() < 0.7:
            draft.given["time-column"] = name
    else:
        draft.truth["sample-rate"] = rate_Hz
        if rng.random() < 0.5:
            draft.given["sample-rate"] = rate_Hz
    draft.kinds["time"] = kind
    layout = draw_layout(rng, draft, header, rows, kind)
    fault = FAULTS[rng.choices(list(FAULTS), [weight for weight, _ in FAULTS.values()])[0]]
    fault_name = next(each for each, pair in FAULTS.items() if pair is fault)
    preamble = layout.pop("preamble")
    lines = Lines(draft, preamble, layout["header"], rows, number, bool(name))
    if not fault[1](rng, lines):
        fault_name = "none"
    write_text(rng, draft, lines, delimiter, is_quoted)
    draft.kinds |= {
        "format": {",": "comma", "\t": "tab", ";": "semicolon", '","': "quoted comma"}.get(delimiter, delimiter),
        "decimal": decimal,
        "time": kind,
        "layout": layout["kind"],
        "fault": fault_name,
    }
    return draft


def draw_time(
    rng: random.Random, draft: Draft, rate_Hz: float, number: Callable[[float], str], decimal: str
) -> tuple[list[str], str, str]:
    """Return the cells of time, their heading ("" without a column of time) and what kind of time it is."""
    t_s, step_ms, start = draft.t_s, 1000 / rate_Hz, EPOCH
    stamps = [start + timedelta(seconds=float(t)) for t in t_s]
    milli = lambda stamp: f"{stamp.microsecond // 1000:03d}"  # noqa: E731
    kind = rng.choices(
        (
            "s",
            "ms",
            "bare ms",
            "us",
            "wrap",
            "ISO",
            "ISO zone",
            "unix ms",
            "unix ns",
            "time of day",
            "US date",
            "German date",
            "none",
        ),
        (30, 12, 6, 6, 5, 8, 8, 5, 4, 6, 4, 4, 8),
    )[0]
    if kind == "s":
        return (
            [number(float(f"{t:.9g}")) for t in t_s],
            rng.choice(("t_s", "time", "Time (s)", "Time [s]", "Zeit (s)", "t")),
            kind,
        )
    if kind in ("ms", "bare ms"):
        draft.truth["time-format"] = "ms"
        heading = (
            rng.choice(("time_ms", "millis", "Time (ms)")) if kind == "ms" else rng.choice(("time", "t", "timestamp"))
        )
        return [f"{1200 + step_ms * k:.0f}" for k in range(len(t_s))], heading, kind
    if kind == "us":
        draft.truth["time-format"] = "us"
        return [f"{1e6 * t + 41_200:.0f}" for t in t_s], rng.choice(("t_us", "micros", "Time (us)")), kind
    if kind == "wrap":
        draft.truth["time-format"] = "us"
        first = 2**32 - int(1e6 * t_s[-1] / 2)
        return [f"{(first + round(1e6 * t)) % 2**32}" for t in t_s], "micros", kind
    if kind == "unix ms":
        draft.truth["time-format"] = "ms"
        return (
            [f"{1_714_557_600_000 + step_ms * k:.0f}" for k in range(len(t_s))],
            rng.choice(("timestamp", "time")),
            kind,
        )
    if kind == "unix ns":
        draft.truth["time-format"] = "ns"
        return [f"{1_714_557_600_000_000_000 + round(1e9 / rate_Hz) * k}" for k in range(len(t_s))], "time", kind
    if kind in ("ISO", "ISO zone"):
        mark, zone = rng.choice("T "), rng.choice(("Z", "+09:00", "+0200")) if kind == "ISO zone" else ""
        draft.truth["time-format"] = "iso"
        return (
            [s.isoformat(mark, "milliseconds") + zone for s in stamps],
            rng.choice(("timestamp", "Time", "time")),
            kind,
        )
    if kind == "time of day":
        return [f"{s:%H:%M:%S}{decimal}{milli(s)}" for s in stamps], "Time", kind
    if kind == "US date":
        draft.truth["time-format"] = "%m/%d/%Y %H:%M:%S.%f"
        return [f"{s:%m/%d/%Y %H:%M:%S}.{milli(s)}" for s in stamps], "Time", kind
    if kind == "German date":
        draft.truth["time-format"] = f"%d.%m.%Y %H:%M:%S{decimal}%f"
        return [f"{s:%d.%m.%Y %H:%M:%S}{decimal}{milli(s)}" for s in stamps], "Zeit", kind
    return ["" for _ in t_s], "", kind


def draw_layout(
    rng: random.Random, draft: Draft, header: list[str], rows: list[list[str]], time: str
) -> dict[str, Any]:
    """Return lines above the header, the header's rows, and what kind of layout it is; columns are added in place."""
    kind = rng.choices(
        (
            "plain",
            "preamble",
            "comments",
            "units row",
            "no header",
            "index column",
            "more columns",
            "sep= line",
            "blank lines",
        ),
        (40, 14, 8, 10, 6, 6, 8, 3, 5),
    )[0]
    lines: list[list[str]] = []
    above: list[str] = []
    if kind == "preamble":
        above = rng.sample(PREAMBLE, rng.randrange(1, 6)) + ([""] if rng.random() < 0.5 else [])
    elif kind == "comments":
        mark = rng.choice(("# ", "% ", "// ", "#"))
        above = [mark + line for line in rng.sample(PREAMBLE, rng.randrange(1, 4))]
    elif kind == "sep= line" and draft.truth["delimiter"] in ",;":
        above = [f"sep={draft.truth['delimiter']}"]
    elif kind == "blank lines":
        draft.kinds["blank lines"] = "yes"
    elif kind == "index column" and draft.truth["delimiter"] != "blanks":
        header.insert(0, "")
        for k, row in enumerate(rows):
            row.insert(0, str(k))
    elif kind == "more columns":
        header += ["Temp_C" if draft.truth["delimiter"] == "blanks" else "Temp (C)", "note"]
        for k, row in enumerate(rows):
            row += ["23" if k % 2 else "24", "press" if k % 7 == 3 else "rest"]
    names: list[list[str]] = [header]
    if kind == "units row":
        unit = {"ms": "ms", "bare ms": "ms", "us": "us", "wrap": "us"}.get(time, "s" if time == "s" else "")
        names.append([*([unit] if "time" in draft.names or len(header) == 3 else []), "V", "N"])
    if kind == "no header":
        names = []
        roles = [role for role in ("time", "output", "reference") if role in draft.names or role != "time"]
        roles = roles if len(header) == 3 else ["output", "reference"]
        if len(header) == 3:
            roles = ["time", "output", "reference"]
        draft.names = {role: f"column_{k + 1}" for k, role in enumerate(roles)}
        if "time" in draft.names:
            draft.truth["time-column"] = draft.given["time-column"] = "column_1"
    draft.truth["header-row"] = len(above) + 1 if names else 0
    return {"kind": kind, "preamble": above, "header": names, "lines": lines}


PREAMBLE = [
    "Instrument: logger 7",
    "Operator: Kim",
    "Date: 2024-05-14",
    "Firmware 2.13",
    "Test of unit A-17",
    "Channels: 2",
    "Comment: second press",
    "HX711 ready.",
]


@dataclass
class Lines:
    """A text file before it is written: a fault changes rows and the truth alike."""

    draft: Draft
    preamble: list[str]
    header: list[list[str]]
    rows: list[list[str]]
    number: Callable[[float], str]
    has_time: bool
    below: list[str] = field(default_factory=list)
    has_end: bool = True
    trailing: int = 0
    is_spaced: bool = False

    def line_of(self, row: int) -> int:
        """Return the line of the file that a row stands in."""
        lines = len(self.preamble) + len(self.header) + row
        return 2 * lines + 1 if "blank lines" in self.draft.kinds else lines + 1

    def column(self, role: str) -> int:
        """Index of the output's or the reference's cell in a row."""
        head = self.header[0] if self.header else None
        if head is None:
            return int(self.draft.names[role].rpartition("_")[2]) - 1
        return head.index(self.draft.names[role])

    def drop(self, rows: Sequence[int]) -> None:
        """Take rows out of the file and of the truth."""
        stay = [k for k in range(len(self.rows)) if k not in set(rows)]
        self.rows = [self.rows[k] for k in stay]
        for name in ("t_s", "output", "reference"):
            setattr(self.draft, name, getattr(self.draft, name)[stay])


Fault = Callable[[random.Random, Lines], bool]


def fault_none(rng: random.Random, lines: Lines) -> bool:
    return True


def fault_empty(rng: random.Random, lines: Lines) -> bool:
    return _replace_cells(rng, lines, "")


def fault_nan(rng: random.Random, lines: Lines) -> bool:
    return _replace_cells(rng, lines, rng.choice(("NaN", "nan", "NAN", "1.#QNAN")))


def fault_text(rng: random.Random, lines: Lines) -> bool:
    text = rng.choice(("N/A", "NA", "OL", "---", "#DIV/0!", "OVLD", "null", "ERR", "no signal"))
    lines.draft.truth["missing"] = (text,)
    return _replace_cells(rng, lines, text)


def fault_word(rng: random.Random, lines: Lines) -> bool:
    """One cell holds a text that nobody would declare: an error with its line."""
    row, column = rng.randrange(5, len(lines.rows) - 5), lines.column("output")
    lines.rows[row][column] += rng.choice(("x", "V?", "..1"))
    lines.draft.blamed = f"line {lines.line_of(row)}\\b"
    return True


def _replace_cells(rng: random.Random, lines: Lines, text: str) -> bool:
    if not text and lines.draft.truth["delimiter"] == "blanks":
        return False
    for row in rng.sample(range(2, len(lines.rows) - 2), rng.randrange(1, 6)):
        lines.rows[row][lines.column("output")] = text
        lines.draft.output[row] = np.nan
    return True


def fault_rows_lost(rng: random.Random, lines: Lines) -> bool:
    if not lines.has_time:
        return False
    start = rng.randrange(10, len(lines.rows) - 20)
    lines.drop(range(start, start + rng.randrange(1, 8)))
    return True


def fault_restart(rng: random.Random, lines: Lines) -> bool:
    """The logger starts again: time goes back, which nothing can mend."""
    if not lines.has_time or lines.draft.kinds["time"] in ("wrap", "time of day"):
        return False  # There it may be another day, and the remark says so.
    cut, time_column = len(lines.rows) // 2, 1 if lines.header and lines.header[0][0] == "" else 0
    for k in range(cut, len(lines.rows)):
        lines.rows[k][time_column] = lines.rows[k - cut][time_column]
    lines.draft.blamed = f"line {lines.line_of(cut)}\\b.*back"
    return True


def fault_header_again(rng: random.Random, lines: Lines) -> bool:
    """The logger writes its header a second time in the middle."""
    if not lines.header:
        return False
    row = rng.randrange(10, len(lines.rows) - 5)
    lines.rows.insert(row, list(lines.header[0]))
    lines.draft.blamed = f"line {lines.line_of(row)}\\b"
    return True


def fault_doubled_row(rng: random.Random, lines: Lines) -> bool:
    """One row stands twice: its time does not advance."""
    if not lines.has_time:
        return False
    row = rng.randrange(10, len(lines.rows) - 5)
    lines.rows.insert(row, list(lines.rows[row]))
    lines.draft.blamed = "repeat"
    return True


def fault_overflow(rng: random.Random, lines: Lines) -> bool:
    """One sample is a code of the converter: the table holds it as it stands; the look at the samples masks it."""
    code = rng.choice(("9.9E37", "8388607", "-9999", "1e30"))
    row = rng.randrange(10, len(lines.rows) - 5)
    lines.rows[row][lines.column("output")] = code.replace(".", lines.draft.truth["decimal"])
    lines.draft.output[row] = float(code)
    return True


def fault_trailing(rng: random.Random, lines: Lines) -> bool:
    if lines.draft.truth["delimiter"] == "blanks":
        return False
    lines.trailing = rng.choice((1, 2))
    return True


def fault_empty_rows(rng: random.Random, lines: Lines) -> bool:
    mark = lines.draft.truth["delimiter"]
    mark = {"blanks": " ", "tab": "\t"}.get(mark, mark)
    lines.below = [mark * 2] * rng.randrange(1, 9)
    return True


def fault_end(rng: random.Random, lines: Lines) -> bool:
    lines.below = [rng.choice(("END", "Test finished", "*** end of data ***"))]
    return True


def fault_torn(rng: random.Random, lines: Lines) -> bool:
    """The last line was not written to its end: it is refused, or a remark names it."""
    lines.below, lines.has_end = [lines.rows[-1][0][:3] or "0"], False
    lines.draft.blamed = f"line {lines.line_of(len(lines.rows))}\\b"
    return True


def fault_decimal_mixed(rng: random.Random, lines: Lines) -> bool:
    """One cell has the other decimal mark."""
    if lines.draft.truth["delimiter"] == ",":
        return False
    row, column = rng.randrange(5, len(lines.rows) - 5), lines.column("output")
    other = {".": ",", ",": "."}[lines.draft.truth["decimal"]]
    mark = lines.draft.truth["decimal"]
    if mark not in lines.rows[row][column]:
        return False
    lines.rows[row][column] = lines.rows[row][column].replace(mark, other)
    lines.draft.blamed = f"line {lines.line_of(row)}\\b"
    return True


def fault_spaces(rng: random.Random, lines: Lines) -> bool:
    lines.is_spaced = lines.draft.truth["delimiter"] not in ("blanks", "\t")
    return lines.is_spaced


FAULTS: dict[str, tuple[float, Fault]] = {
    "none": (40, fault_none),
    "empty cells": (9, fault_empty),
    "NaN": (6, fault_nan),
    "text for missing": (7, fault_text),
    "a word in a cell": (4, fault_word),
    "rows lost": (7, fault_rows_lost),
    "time goes back": (4, fault_restart),
    "header again": (3, fault_header_again),
    "doubled row": (3, fault_doubled_row),
    "overflow code": (5, fault_overflow),
    "trailing delimiters": (6, fault_trailing),
    "empty rows below": (5, fault_empty_rows),
    "end marker": (4, fault_end),
    "torn last line": (3, fault_torn),
    "other decimal mark": (3, fault_decimal_mixed),
    "blanks in cells": (4, fault_spaces),
}


def write_text(rng: random.Random, draft: Draft, lines: Lines, delimiter: str, is_quoted: bool) -> None:
    """Join the rows and encode them."""
    mark = {"blanks": rng.choice((" ", "  ")), '","': ","}.get(delimiter, delimiter)
    if lines.is_spaced:
        mark += " "
    quote = (lambda cell: f'"{cell}"') if is_quoted else (lambda cell: cell)
    quoted_head = [
        [f'"{cell}"' if is_quoted or mark.strip() and mark.strip() in cell else cell for cell in row]
        for row in lines.header
    ]
    text_rows = [mark.join(row) + mark * lines.trailing for row in quoted_head]
    text_rows += [mark.join(map(quote, row)) + mark * lines.trailing for row in lines.rows]
    end = "\n\n" if draft.kinds.pop("blank lines", "") else "\n"
    text = end.join([*lines.preamble, *text_rows, *lines.below]) + ("\n" if lines.has_end else "")
    encoding = rng.choices(("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252", "cp949"), (60, 12, 8, 3, 12, 5))[0]
    if encoding in ("cp1252", "cp949") and lines.preamble and not lines.preamble[0].startswith("sep="):
        word = "Größe µ" if encoding == "cp1252" else "시험 대상"
        text = text.replace(lines.preamble[0], f"{lines.preamble[0]} {word}", 1)
    draft.truth["encoding"] = "utf-8" if encoding == "utf-8-sig" else encoding
    draft.content = text.replace("\n", rng.choice(("\n", "\r\n", "\r\n", "\r"))).encode(encoding)
    draft.suffix = ".csv" if mark.strip() in (",", ";") else rng.choice((".txt", ".dat", ".csv"))
    draft.kinds["encoding"] = encoding


def options_of(draft: Draft, declared: dict[str, Any]) -> ColumnNames:
    """Return what a person states of the file."""
    names = {"delimiter": "delimiter", "decimal": "decimal", "encoding": "encoding", "header-row": "header_row"}
    names |= {"sheet": "sheet", "time-format": "time_format", "missing": "missing"}
    table = TableOptions(**{names[key]: value for key, value in declared.items() if key in names})
    if table.delimiter == "\t":
        table = replace(table, delimiter="tab")
    return ColumnNames(
        draft.names["output"],
        declared.get("time-column"),
        draft.names["reference"],
        None,
        declared.get("sample-rate"),
        table,
    )


def check_import(draft: Draft, path: Path) -> tuple[str, str]:
    """Return the outcome of a file and the line that says why."""
    declared, refusals = dict(draft.given), list[str]()
    for _ in range(MAX_TRIES):
        try:
            names = options_of(draft, declared)
            file = inspect_recording(path, "A", declared.get("sample-rate"), names=names, with_reference=True)
        except InputError as error:
            refusals.append(str(error))
            options_asked = [key for key in OPTIONS if re.search(rf"--{key}\b|{key.replace('-', ' ')}", refusals[-1])]
            new = {key: draft.truth[key] for key in options_asked if key in draft.truth and key not in declared}
            if draft.blamed and re.search(draft.blamed, refusals[-1]):
                return CURED, refusals[0]
            if not new:
                return WRONG_CURE, refusals[-1]
            declared |= new
            continue
        wrong = difference(draft, file)
        if draft.blamed and not wrong and not any(re.search(draft.blamed, remark) for remark in file.remarks):
            wrong = "a fault that nobody was told of"
        if wrong:
            return SILENT, f"{wrong}; {file.table.layout}; {file.remarks}"
        return (CURED, refusals[0]) if refusals else (RIGHT, "")
    return WRONG_CURE, refusals[-1]


def difference(draft: Draft, file: FileRecording) -> str:
    """Return what differs from what was drawn; "" where nothing does."""
    t_s, columns = file.columns["t_s"], file.columns
    if len(t_s) != len(draft.t_s):
        return f"{len(t_s)} rows where {len(draft.t_s)} were drawn"
    if not np.allclose(t_s - t_s[0], draft.t_s - draft.t_s[0], rtol=0, atol=2e-6):
        return f"time {t_s[0]:g} to {t_s[-1]:g} s where {draft.t_s[0]:g} to {draft.t_s[-1]:g} s was drawn"
    for role in ("output", "reference"):
        expected = getattr(draft, role)
        if not np.array_equal(np.isnan(columns[role]), np.isnan(expected)):
            return f"other samples of the {role} are missing"
        if not np.allclose(columns[role], expected, rtol=1e-9, atol=0, equal_nan=True):
            return f"{role} {columns[role][:3]} where {expected[:3]} was drawn"
    return ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=int, default=1500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", type=int, default=3, help="examples of each bad outcome")
    parser.add_argument("--keep", type=Path, help="folder for the files that ended badly")
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    by_kind: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    examples: dict[str, list[str]] = defaultdict(list)
    start_s = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as folder:
        for number in range(options.files):
            draft = draw(random.Random(f"{options.seed} {number}"))
            path = Path(folder) / f"f{number}{draft.suffix}"
            path.write_bytes(draft.content)
            outcome, line = check_import(draft, path)
            counts[outcome] += 1
            for kind, value in draft.kinds.items():
                by_kind[kind, value][outcome] += 1
            if outcome in (WRONG_CURE, SILENT):
                examples[outcome].append(f"{path.name} {draft.kinds}: {line.replace(str(path), path.name)}")
                if options.keep:
                    options.keep.mkdir(exist_ok=True)
                    (options.keep / path.name).write_bytes(draft.content)
            path.unlink()
    total = sum(counts.values())
    rows = [("all", "", total, *(f"{100 * counts[each] / total:.1f}" for each in OUTCOMES))]
    for (kind, value), part in sorted(by_kind.items()):
        n = sum(part.values())
        rows.append((kind, value, n, *(f"{100 * part[each] / n:.1f}" for each in OUTCOMES)))
    print_table(("kind", "drawn", "n", *(f"{each} %" for each in OUTCOMES)), rows)
    for outcome, lines in examples.items():
        print(f"\n{outcome}: {len(lines)}")
        for line in lines[: options.show]:
            print(f"  {line}")
    print(f"\n{total} files in {time.perf_counter() - start_s:.0f} s, seed {options.seed}")
    return 1 if counts[SILENT] else 0


if __name__ == "__main__":
    sys.exit(main())
