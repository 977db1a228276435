"""Files of a logger in a lot folder as they are: lot.toml states how they are read."""

from pathlib import Path

import numpy as np
import pytest

from softcal.app.files.lot_folder import open_lot_folder
from softcal.core.errors import InputError

TABLE = '[table]\noutput = "Signal [V]"\nreference = "Force"\ntime = "Zeit"\nmissing = ["OL"]\n'


def _folder(folder: Path, toml: str) -> Path:
    lines = ["Logger 7", "Zeit;Signal [V];Force"]
    for k in range(60):
        lines.append(f"{k / 50:.2f};{0.5 + 0.01 * (k % 20):.3f};{k % 20:.1f}".replace(".", ","))
    lines[12] = lines[12].split(";")[0] + ";OL;1,0"
    for name in ("source/A0.csv", "units/A1.csv", "audit/A1.csv"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "lot.toml").write_text(f'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "x"\n{toml}')
    return folder


def test_stated_columns_and_texts_are_read_in_every_part_of_the_folder(tmp_path: Path) -> None:
    folder = open_lot_folder(_folder(tmp_path, TABLE))
    assert not folder.remarks
    audit = folder.read_audit("A1")
    assert audit is not None
    for recording in (folder.read_source().unlabelled, folder.read_unit("A1"), audit.unlabelled):
        assert len(recording) == 59 and 0.2 not in recording.t_s
        np.testing.assert_allclose(recording.output[:3], [0.5, 0.51, 0.52])


def test_without_the_statement_the_columns_are_named_in_the_refusal(tmp_path: Path) -> None:
    folder = open_lot_folder(_folder(tmp_path, ""))
    with pytest.raises(InputError, match="'output'.*Zeit, Signal"):
        folder.read_unit("A1")


def test_a_wrong_statement_is_refused_or_remarked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="header_row"):
        open_lot_folder(_folder(tmp_path, '[table]\nheader_row = "two"\n'))
    (remark,) = open_lot_folder(_folder(tmp_path, "[table]\nrow = 2\n")).remarks
    assert "row" in remark and "header_row" in remark
