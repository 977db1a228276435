"""A logger's faults in a lot: named with their line and masked; no verdict rests on them, none is said of the unit."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8", "--no-own")
UNIT_FAULTS = ("dead.", "creep", "drift", "saturated", "stuck", "too_little_data")
"""Codes of reasons that blame a unit or its press."""


def batch(folder: Path, url: str, tmp_path: Path) -> tuple[int, dict[str, dict]]:
    file = tmp_path / "report.json"
    file.unlink(missing_ok=True)
    code = main(["batch", str(folder), "--registry", url, *SMALL, "--json", str(file)])
    units = json.loads(file.read_text())["units"] if file.exists() else []
    return code, {unit["serial"]: unit for unit in units}


def change(folder: Path, name: str, edit: Callable[[pd.DataFrame], pd.DataFrame | None]) -> None:
    """Edit one recording of a lot folder."""
    table = pd.read_csv(folder / name)
    changed = edit(table)
    (table if changed is None else changed).to_csv(folder / name, index=False)


def without_audits(folder: Path) -> None:
    for path in (folder / "audit").iterdir():
        path.unlink()


@pytest.fixture
def clean(lot_folder: Path, registry_url: str, tmp_path: Path) -> dict[str, dict]:
    """What the small lot says without a fault, and nobody measured."""
    without_audits(lot_folder)
    return batch(lot_folder, registry_url, tmp_path)[1]


def test_a_code_in_place_of_a_sample_is_named_and_changes_no_verdict(
    clean: dict[str, dict], lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    for serial, code in (("A1", 8388607), ("A2", 9.9e37), ("A3", -9999)):

        def edit(table: pd.DataFrame, code: float = code) -> None:
            table.loc[600, "output"] = code

        change(lot_folder, f"units/{serial}.csv", edit)
    units = batch(lot_folder, registry_url, tmp_path)[1]
    for serial, unit in units.items():
        assert unit["verdict"] == clean[serial]["verdict"]
        assert unit["predicted_rmse"] == pytest.approx(clean[serial]["predicted_rmse"], rel=0.05)
        assert unit["reason_codes"][0] == "masked.overflow" and "line 602" in unit["reasons"][0]
        assert not [code for code in unit["reason_codes"] if code.startswith(UNIT_FAULTS)]
        assert unit["missing"]["masked_overflow"] == 1


@pytest.mark.parametrize("kind", ["zero", "half", "rail", "empty"])
def test_a_loose_cable_is_named_and_the_forecast_stays(
    kind: str, clean: dict[str, dict], lot_folder: Path, registry_url: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    def edit(table: pd.DataFrame) -> None:
        for start in (100, 400, 700, 1000, 1300):
            rows = np.arange(start, start + rng.integers(1, 4))
            output = table.loc[rows, "output"]
            table.loc[rows, "output"] = {"zero": 0.0, "half": output / 2, "rail": 5.0, "empty": np.nan}[kind]

    for serial in clean:
        change(lot_folder, f"units/{serial}.csv", edit)
    units = batch(lot_folder, registry_url, tmp_path)[1]
    for serial, unit in units.items():
        assert unit["verdict"] == clean[serial]["verdict"]
        assert unit["predicted_rmse"] == pytest.approx(clean[serial]["predicted_rmse"], rel=0.05)
        assert unit["reason_codes"][0] == ("masked.missing" if kind == "empty" else "masked.spike")
        assert "line 102" in unit["reasons"][0]


def test_missing_rows_are_counted_and_too_many_are_a_retest(
    clean: dict[str, dict], lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    kept_rows = {
        "A1": np.r_[0:500, 600:1500],
        "A2": np.r_[0:500, 800:1500],
        "A3": np.r_[0:900, 900:1500:5],
    }
    for serial, rows in kept_rows.items():
        change(lot_folder, f"units/{serial}.csv", lambda table, rows=rows: table.iloc[rows])
    units = batch(lot_folder, registry_url, tmp_path)[1]
    few, many, slow = (units[serial] for serial in kept_rows)
    assert few["verdict"] == clean["A1"]["verdict"] and few["reason_codes"][0] == "gaps"
    assert "2.02 s" in few["reasons"][0] and "samples missing: 100, 7%" in " ".join(few["reasons"][0].split())
    assert many["verdict"] == slow["verdict"] == "retest"
    assert many["reason_codes"][0] == slow["reason_codes"][0] == "samples_missing"
    assert "20%" in many["reasons"][0] and "10 Hz" in slow["reasons"][0]
    for unit in units.values():
        assert not [code for code in unit["reason_codes"] if code.startswith(UNIT_FAULTS)]


def tared(table: pd.DataFrame) -> None:
    table.loc[300:, "reference"] -= 1.0


def late(table: pd.DataFrame) -> None:
    table["reference"] = table["reference"].shift(25).fillna(0.0)


def hold_reference(table: pd.DataFrame) -> None:
    table["reference"] = table["reference"].to_numpy()[np.arange(len(table)) // 6 * 6]


@pytest.mark.parametrize(("edit", "reason_text"), [(tared, "line 302"), (late, "later"), (hold_reference, "8.33 Hz")])
@pytest.mark.parametrize("command", ["train", "batch"])
def test_a_source_whose_reference_labels_nothing_ends_the_command(
    command: str, edit: Callable, reason_text: str, lot_folder: Path, registry_url: str, capsys: pytest.CaptureFixture
) -> None:
    change(lot_folder, "source/A0.csv", edit)
    assert main([command, str(lot_folder), "--registry", registry_url, "--hidden", "16,8"]) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert "A0.csv" in message and reason_text in message


def test_an_overflow_in_the_force_of_the_source_is_masked_and_blames_no_unit(
    clean: dict[str, dict],
    lot_folder: Path,
    registry_url: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture,
) -> None:
    def edit(table: pd.DataFrame) -> None:
        table.loc[600, "reference"] = 9.9e37

    change(lot_folder, "source/A0.csv", edit)
    capsys.readouterr()
    units = batch(lot_folder, registry_url, tmp_path)[1]
    assert "A0.csv: line 602" in capsys.readouterr().err
    for serial, unit in units.items():
        assert unit["verdict"] == clean[serial]["verdict"]
        assert "wrong_programme" not in set(unit["reason_codes"]) - set(clean[serial]["reason_codes"])


@pytest.mark.parametrize(("edit", "message"), [(tared, "line 302"), (late, "later"), (hold_reference, "8.33 Hz")])
def test_an_audit_whose_reference_labels_nothing_fails_no_unit(
    edit: Callable, message: str, lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    change(lot_folder, "audit/A1.csv", edit)
    unit = batch(lot_folder, registry_url, tmp_path)[1]["A1"]
    assert unit["verdict"] == "conditional" and not unit["audited"] and unit["after_rmse"] is None
    assert unit["reason_codes"][0] == "audit.unreadable" and message in unit["reasons"][0]


def test_what_is_masked_is_stored_with_the_recording(lot_folder: Path, registry_url: str, tmp_path: Path) -> None:
    def edit(table: pd.DataFrame) -> None:
        table.loc[600, "output"], table.loc[700, "output"] = -9999, np.nan

    change(lot_folder, "units/A1.csv", edit)
    batch(lot_folder, registry_url, tmp_path)
    with open_registry(registry_url) as registry:
        entry = registry.recordings.of_lot("small", "A1", "unit")[-1]
        masked = registry.recordings.get(entry.sha256).masked
    assert masked.counts == {"missing": 1, "overflow": 1}
    assert sorted(masked.lines.tolist()) == [602, 702] and -9999 in masked.values


def test_inspect_shows_a_table_and_finds_what_is_in_it(
    tmp_path: Path, press_unit, capsys: pytest.CaptureFixture
) -> None:
    table = press_unit(1500, 1.0, 0.5, 3).rename(columns={"output": "output_V", "reference": "force_N"})
    table.loc[600, "output_V"] = 8388607
    table.loc[900:, "force_N"] -= 1.0
    path, out = tmp_path / "logger.csv", tmp_path / "found.json"
    table.drop(index=range(1000, 1100)).to_csv(path, index=False)
    columns = ("--output-column", "output_V", "--reference-column", "force_N")
    assert main(["inspect", str(path), *columns, "--json", str(out)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "50 Hz" in text and "line 602" in text and "8388607" in text and "tared" in text
    content = json.loads(out.read_text())
    assert content["schema"] == "softcal.inspection/1" and content["masked"] == {"overflow": 1}
    lines = {one["kind"]: one["line"] for one in content["findings"]}
    assert lines["overflow"] == 602 and lines["tare"] == 902 and lines["gap"] == 1002


def test_an_output_in_another_unit_or_one_that_jumps_is_named_so(
    clean: dict[str, dict], lot_folder: Path, registry_url: str, tmp_path: Path
) -> None:
    def in_millivolts(table: pd.DataFrame) -> None:
        table["output"] *= 1000

    def jumping(table: pd.DataFrame) -> None:
        table.loc[700:, "output"] += 0.5 * np.ptp(table["output"])

    change(lot_folder, "units/A1.csv", in_millivolts)
    change(lot_folder, "units/A2.csv", jumping)
    units = batch(lot_folder, registry_url, tmp_path)[1]
    assert units["A1"]["verdict"] == "retest" and units["A1"]["reason_codes"][0] == "other_unit"
    assert "1000 times" in " ".join(units["A1"]["reasons"][0].split())
    assert units["A2"]["reason_codes"][0] == "stepped" and "14.00 s" in units["A2"]["reasons"][0]
    assert units["A3"]["reason_codes"] == clean["A3"]["reason_codes"]


def test_a_batch_tells_how_files_were_read_and_what_was_left_out(
    lot_folder: Path, registry_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without_audits(lot_folder)
    source = f"source/{next((lot_folder / 'source').iterdir()).stem}"
    for name in (source, "units/A1", "units/A2"):
        table = pd.read_csv(lot_folder / f"{name}.csv")
        rows = [";".join(f"{value:.9g}".replace(".", ",") for value in row) for row in table.to_numpy()]
        lines = ["Logger 7", "", ";".join(table.columns), ";".join(["s", "V", "N"][: len(table.columns)]), *rows]
        (lot_folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
    with (lot_folder / "units/A2.csv").open("a") as file:
        file.write("Stopped by hand\n")
    report = tmp_path / "report.json"
    main(["batch", str(lot_folder), "--registry", registry_url, *SMALL, "--json", str(report)])
    content, printed = json.loads(report.read_text()), capsys.readouterr()
    layout = "semicolons; decimal comma; header in line 3; units in line 4"
    assert {name for name, one in content["layouts"].items() if one == layout} == {
        f"{source}.csv", "units/A1.csv", "units/A2.csv",
    }  # fmt: skip
    assert content["layouts"]["units/A3.csv"] == ""
    assert printed.err.count(layout) == 1 and f"{source}.csv and 2 more" in printed.err
    assert any("units/A2.csv" in remark and "Stopped by hand" in remark for remark in content["remarks"])
    assert "Stopped by hand" in printed.out + printed.err


def test_an_audit_in_another_unit_or_of_another_sign_is_named_at_every_entry_point(
    lot_folder: Path, registry_url: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = next((lot_folder / "source").iterdir())
    audits = sorted((lot_folder / "audit").iterdir())
    changes = {audits[0].stem: ("kgf", 1 / 9.80665), audits[1].stem: ("sign", -1.0)}
    for serial, (_, factor) in changes.items():
        table = pd.read_csv(lot_folder / f"audit/{serial}.csv")
        table.assign(reference=table["reference"] * factor).to_csv(lot_folder / f"audit/{serial}.csv", index=False)

    def check_named(text: str) -> None:
        for serial, (word, _) in changes.items():
            assert [line for line in text.splitlines() if serial in line and word in line], text

    report = tmp_path / "report.json"
    main(["batch", str(lot_folder), "--registry", registry_url, *SMALL, "--json", str(report)])
    capsys.readouterr()
    check_named("\n".join(json.loads(report.read_text())["remarks"]))

    for serial, (word, _) in changes.items():
        main(["inspect", str(lot_folder / f"audit/{serial}.csv"), "--source", str(source)])
        assert word in capsys.readouterr().out
    main(["inspect", str(audits[2]), "--source", str(source)])
    assert "kgf" not in (plain := capsys.readouterr().out) and "sign" not in plain

    files = [str(source), *(str(lot_folder / f"audit/{serial}.csv") for serial in changes)]
    imported = ["import", *files, "--source", source.stem, "--reference-column", "reference", "--audit"]
    main([*imported, "--out", str(tmp_path / "lot-2"), "--sample-rate", "50"])
    check_named(capsys.readouterr().err)
    main(["lot", "audit", str(lot_folder), *files[1:], "--reference-column", "reference"])
    check_named(capsys.readouterr().err)
