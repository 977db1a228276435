"""Files that a browser drops: kept for this tab, read once, mapped to columns."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import streamlit as st

from softcal.app.files.import_plan import Columns
from softcal.app.tables.options import TableOptions
from softcal.app.tables.read import READERS, read_table
from softcal.app.ui.presentation import localize, translate
from softcal.app.ui.uploads import UploadFolder
from softcal.core.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

NEW_LOT = "new-lot"
"""Which field of files is meant, where a page has one of its own."""

ROWS = 5
MARKS = (",", ";", "tab", "|", "blanks")
"""Between cells."""

NAMES = {
    "output": ("output", "output_v", "out", "v", "voltage"),
    "reference": ("reference", "force_n", "force", "pressure", "load", "ref"),
    "time": ("t_s", "time_s", "time", "t"),
    "stage": ("stage_mm", "stage", "position_mm"),
}
"""Names that tables often have for a column; what fits first is offered."""


def dropped_files(field: str = NEW_LOT) -> list[Path]:
    """Draw the field for files; return where they lie. A name dropped twice is one file."""
    kinds = sorted(suffix[1:] for suffix in READERS)
    # A field that was forgotten is another one afterwards, so that it is empty.
    key = f"{field}-files-{st.session_state.get(f'{field}-forgotten', 0)}"
    dropped = st.file_uploader(translate("new_lot.files"), type=kinds, accept_multiple_files=True, key=key)
    if not dropped:
        return []
    # A default would be made at every run, whether it is needed or not.
    if _folder(field) not in st.session_state:
        st.session_state[_folder(field)] = UploadFolder()
    folder: Path = st.session_state[_folder(field)].path
    folder.mkdir(exist_ok=True)
    paths: dict[str, Path] = {}
    for file in dropped:
        # A browser may send any name: only its last part is one here.
        name = re.sub(r"[\x00-\x1f/\\]", "_", Path(file.name).name) or "file"
        path = folder / name
        if not path.is_file() or path.stat().st_size != file.size or st.session_state.get(str(path)) != file.file_id:
            path.write_bytes(file.getvalue())
            st.session_state[str(path)] = file.file_id
        paths[name] = path
    for stale_path in set(folder.iterdir()) - set(paths.values()):
        stale_path.unlink()
    return [paths[name] for name in sorted(paths)]


def forget_files(field: str = NEW_LOT) -> None:
    """Remove what was dropped; it is kept elsewhere now."""
    if (folder := st.session_state.pop(_folder(field), None)) is not None:
        folder.remove()
    st.session_state[f"{field}-forgotten"] = st.session_state.get(f"{field}-forgotten", 0) + 1


def _folder(field: str) -> str:
    return f"{field}-folder"


def choose_layout() -> TableOptions:
    """Draw what a person can state of the tables' layout; what is left empty is detected."""
    with st.expander(translate("layout.title"), icon=":material/table_rows:"):
        st.caption(translate("layout.how"))
        first, second, third, fourth = st.columns(4)
        unset = translate("layout.detected")
        delimiter = first.selectbox(
            translate("layout.delimiter"), [None, *MARKS], format_func=lambda one: one or unset, key="new-lot-delimiter"
        )
        decimal = second.selectbox(
            translate("layout.decimal"), [None, ".", ","], format_func=lambda one: one or unset, key="new-lot-decimal"
        )
        encoding = third.text_input(translate("layout.encoding"), placeholder="utf-16", key="new-lot-encoding").strip()
        header_row = fourth.number_input(translate("layout.header_row"), 0, value=None, key="new-lot-header-row")
        first, second, third, _ = st.columns(4)
        sheet = first.text_input(translate("layout.sheet"), key="new-lot-sheet").strip()
        time_format = second.text_input(
            translate("layout.time_format"), placeholder="ms", key="new-lot-time-format"
        ).strip()
        missing = third.text_input(translate("layout.missing"), placeholder="OL; --", key="new-lot-missing")
    return TableOptions(
        delimiter=delimiter,
        decimal=decimal,
        encoding=encoding or None,
        header_row=None if header_row is None else int(header_row),
        sheet=sheet or None,
        time_format=time_format or None,
        missing=tuple(text for part in missing.split(";") if (text := part.strip())),
    )


def first_readable(files: Sequence[Path], options: TableOptions) -> "tuple[Path, pd.DataFrame] | None":
    """Return the first file that can be read as a table; say why where none can."""
    refusal = ""
    for path in files:
        try:
            return path, _table(str(path), path.stat().st_mtime_ns, options)
        except InputError as error:
            refusal = refusal or localize(str(error).replace(f"{path}: ", f"{path.name}: "))
    st.error(refusal, icon=":material/error:")
    return None


@st.cache_resource(max_entries=8, show_spinner=False)
def _table(path: str, written_ns: int, options: TableOptions) -> "pd.DataFrame":  # noqa: V107
    return read_table(Path(path), options).to_frame()


def choose_columns(table: "pd.DataFrame", wide: bool) -> Columns:
    """Draw the choice of columns with what the table's names suggest."""
    names = [str(name) for name in table.columns]
    left, second, third, right = st.columns(4)
    if wide:
        # The largest group of columns that differ by a number.
        stems = [re.sub(r"\d+$", "", name) for name in names]
        often = max(set(stems), key=lambda stem: (stems.count(stem), len(stem)))
        pattern = f"{often}*" if stems.count(often) > 1 else "*"
        output = str(left.text_input(translate("new_lot.pattern"), pattern, key="new-lot-pattern")).strip()
    else:
        output = str(
            left.selectbox(translate("new_lot.output"), names, index=_guess("output", names) or 0, key="new-lot-output")
        )
    optional, unset, chosen = [None, *names], translate("new_lot.no_column"), []
    for slot, name in ((second, "reference"), (third, "time"), (right, "stage")):
        index = _guess(name, names)
        index = 0 if index is None else index + 1
        label, key = translate(f"new_lot.{name}"), f"new-lot-{name}"
        chosen.append(slot.selectbox(label, optional, index, lambda one: unset if one is None else one, key))
    return Columns(output or "*", *chosen)


def _guess(name: str, columns: Sequence[str]) -> int | None:
    lower = [column.lower() for column in columns]
    return next((lower.index(word) for word in NAMES[name] if word in lower), None)
