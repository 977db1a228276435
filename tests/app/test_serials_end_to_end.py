"""Serials of any script from a file to every export; names that are none, and units that two files name, in a lot."""

import io
import json
import shutil
import subprocess
import unicodedata
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from fastapi.testclient import TestClient

from softcal.app.cli.main import main
from softcal.app.connect.events import path_part
from softcal.app.export.check import check_folder
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.rest.server import rest_app
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.core.errors import InputError
from softcal.core.export.blob_reader import read_unit
from softcal.core.lot import unescape_serial
from softcal.db.connection import open_registry
from tests.device_sensor import open_sensor

SERIALS = {"A1": "센서-001", "A2": "Gerät_7", "A3": "압력.3"}
FORMATS = ("json", "c", "blob", "hex", "onnx", "pdf", "dcc")
SMALL = ("--hidden", "16,8", "--no-own")


def _batch(folder: Path, url: str) -> tuple[int, dict[str, dict]]:
    report = folder.parent / "report.json"
    code = main(["batch", str(folder), "--registry", url, "--json", str(report), *SMALL])
    return code, {unit["serial"]: unit for unit in json.loads(report.read_text())["units"]}


def _renamed(folder: Path, serials: dict[str, str], form: str = "NFC") -> Path:
    for old, new in serials.items():
        for subfolder in ("units", "audit"):
            (folder / subfolder / f"{old}.csv").rename(folder / subfolder / f"{unicodedata.normalize(form, new)}.csv")
    return folder


@pytest.fixture(scope="module")
def korean(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """URL of a registry in which a lot with serials of several scripts is calibrated; its files come from a Mac."""
    root = tmp_path_factory.mktemp("korean")
    shutil.copy(trained_lot / "registry.db", root / "registry.db")
    folder = _renamed(Path(shutil.copytree(trained_lot / "lot", root / "lot")), SERIALS, "NFD")
    url = f"sqlite:///{root / 'registry.db'}"
    code, units = _batch(folder, url)
    assert code in (0, 1)
    assert sorted(units) == sorted(SERIALS.values())
    assert all(unit["after_rmse"] < 0.5 * unit["before_rmse"] for unit in units.values())
    return url


@pytest.mark.parametrize("name", FORMATS)
def test_a_serial_of_any_script_has_every_export(korean: str, tmp_path: Path, name: str) -> None:
    out = tmp_path / "out"
    options = [word for serial in SERIALS.values() for word in ("--serial", serial)]
    assert (
        main(
            [
                "export",
                "--registry",
                korean,
                *options,
                "--format",
                name,
                "--out",
                str(out),
                "--release",
                "conditional",
                "--failed-too",
            ]
        )
        == 0
    )
    unit_files = [path.name for path in out.iterdir() if path.name.startswith(("unit-", "certificate-"))]
    assert len(unit_files) == 3 and all(file.isascii() for file in unit_files)
    assert {unescape_serial(file.partition("-")[2].rpartition(".")[0]) for file in unit_files} == set(SERIALS.values())
    assert not check_folder(out).problems
    assert set(json.loads((out / "manifest.json").read_text())["units"]) == set(SERIALS.values())


def test_a_device_file_names_its_unit_and_no_other(korean: str, tmp_path: Path) -> None:
    options = [word for serial in SERIALS.values() for word in ("--serial", serial)]
    main(
        [
            "export",
            "--registry",
            korean,
            *options,
            "--format",
            "blob",
            "--out",
            str(tmp_path),
            "--release",
            "conditional",
            "--failed-too",
        ]
    )
    (network,) = tmp_path.glob("network-*.ssc")
    for path in tmp_path.glob("unit-*.ssc"):
        content = path.read_bytes()
        serial = read_unit(content).serial
        assert serial in SERIALS.values()
        open_sensor(network.read_bytes(), content, serial)
        for other in {*SERIALS.values(), "A1"} - {serial}:
            with pytest.raises(InputError):
                open_sensor(network.read_bytes(), content, other)


def test_headers_of_several_units_compile_together(
    korean: str, tmp_path: Path, require: Callable[[object, str], None]
) -> None:
    require(shutil.which("cc"), "no C compiler")
    options = [word for serial in SERIALS.values() for word in ("--serial", serial)]
    main(
        [
            "export",
            "--registry",
            korean,
            *options,
            "--format",
            "c",
            "--out",
            str(tmp_path),
            "--release",
            "conditional",
            "--failed-too",
        ]
    )
    headers = [path.name for path in sorted(tmp_path.glob("*.h")) if path.name != "softsensor.h"]
    includes = "".join(f'#include "{name}"\n' for name in headers)
    source = tmp_path / "all.c"
    source.write_text(f"{includes}int main(void) {{ return SS_UNIT_SERIAL[0] == 0; }}\n")
    built = subprocess.run(
        ["cc", "-std=c99", "-pedantic", "-Werror", "-Wno-unused-variable", "all.c", "-o", "all"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    assert subprocess.run([tmp_path / "all"]).returncode == 0


def test_rest_takes_a_serial_of_any_script(korean: str, tmp_path: Path, add_everybody: Callable[[str], None]) -> None:
    url = f"sqlite:///{shutil.copy(korean.removeprefix('sqlite:///'), tmp_path / 'own.db')}"
    add_everybody(url)
    with open_registry(url) as registry:
        secret = registry.tokens.add("Erin", "a test", 1)[1]
        client = TestClient(rest_app(registry), headers={"Authorization": f"Bearer {secret}"})
        for serial in SERIALS.values():
            for form in ("NFC", "NFD"):
                part = path_part(unicodedata.normalize(form, serial))
                assert part.isascii() and not set("/+#") & set(part)  # Of a path, of an MQTT topic.
                assert client.get(f"/v1/lots/small/units/{part}").json()["serial"] == serial
            answer = client.post(f"/v1/lots/small/units/{part}/files/json")
            assert answer.status_code == 200
            name = answer.headers["content-disposition"].partition('filename="')[2].removesuffix('-json.zip"')
            assert name.startswith("small-") and unescape_serial(name.removeprefix("small-")) == serial
            with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
                assert all(name.isascii() for name in archive.namelist())


def test_commands_find_a_serial_in_either_normal_form(korean: str, tmp_path: Path, lot_folder: Path) -> None:
    for form in ("NFC", "NFD"):
        serial, out = unicodedata.normalize(form, SERIALS["A1"]), tmp_path / f"{form}.csv"
        options = ("--serial", serial, "--registry", korean, "--out", str(out))
        assert main(["estimate", str(lot_folder / "units/A1.csv"), *options]) == 0
    assert (tmp_path / "NFC.csv").read_text() == (tmp_path / "NFD.csv").read_text()


def test_tables_with_serials_of_any_script_are_imported(tmp_path: Path, lot_folder: Path) -> None:
    for old, new in (("source/A0", "기준"), ("units/A1", "센서-001"), ("units/A2", "Gerät_7")):
        shutil.copy(lot_folder / f"{old}.csv", tmp_path / f"{unicodedata.normalize('NFD', new)}.csv")
    options = ("--source", "기준", "--reference-column", "reference", "--out", str(tmp_path / "imported"))
    assert main(["import", *map(str, tmp_path.glob("*.csv")), *options]) == 0
    folder = open_lot_folder(tmp_path / "imported")
    assert folder.lot.source == "기준" and sorted(folder.unit_paths) == ["Gerät_7", "센서-001"]
    assert not folder.problems


BAD = ("bad name!", "센서 2", "a\u202eb", "x..y", "CON", "-1", "y" * 70)


def test_names_that_are_no_serials_are_rows_and_the_other_units_are_calibrated(
    lot_folder: Path, registry_url: str, english_in: Callable[[str], list[str]]
) -> None:
    for bad in BAD:
        shutil.copy(lot_folder / "units/A3.csv", lot_folder / f"units/{bad}.csv")
    _, units = _batch(lot_folder, registry_url)
    assert all(units[serial]["after_rmse"] < 0.5 * units[serial]["before_rmse"] for serial in SERIALS)
    refused = {serial: unit for serial, unit in units.items() if serial not in SERIALS}
    assert len(refused) == len(BAD)
    assert {bad for bad in BAD if bad.isprintable() and len(bad) <= 64} <= refused.keys()
    for serial, unit in refused.items():
        assert serial.isprintable() and len(serial) <= 64
        assert unit["verdict"] == "retest" and "serial" in unit["reasons"][0]
    for why in open_lot_folder(lot_folder).problems.values():
        assert (
            english_in(render_reason(why, partial(text, "ko")).replace(str(why.values.get("character", "")), "")) == []
        )


def test_one_name_that_is_no_serial_stops_no_lot_of_three(lot_folder: Path, registry_url: str) -> None:
    (lot_folder / "units/A2.csv").rename(lot_folder / "units/A 2.csv")
    _, units = _batch(lot_folder, registry_url)
    assert sorted(units) == ["A 2", "A1", "A3"]
    assert units["A 2"]["verdict"] == "retest" and "U+0020 SPACE" in units["A 2"]["reasons"][0]
    assert units["A1"]["after_rmse"] and units["A3"]["after_rmse"]


@pytest.mark.parametrize("other", ["A1.parquet", "a1.csv"])
def test_two_files_of_one_serial_are_named_and_neither_is_calibrated(
    lot_folder: Path, registry_url: str, other: str
) -> None:
    table = pd.read_csv(lot_folder / "units/A2.csv")
    path = lot_folder / "units" / other
    table.to_parquet(path) if path.suffix == ".parquet" else table.to_csv(path, index=False)
    _, units = _batch(lot_folder, registry_url)
    for serial in {"A1", path.stem}:
        assert units[serial]["verdict"] == "retest"
        assert "A1.csv" in units[serial]["reasons"][0] and other in units[serial]["reasons"][0]
    assert units["A2"]["after_rmse"] and units["A3"]["after_rmse"]


def test_two_normal_forms_are_one_serial(lot_folder: Path) -> None:
    for form in ("NFC", "NFD"):
        shutil.copy(lot_folder / "units/A1.csv", lot_folder / f"units/{unicodedata.normalize(form, '센서')}.csv")
    folder = open_lot_folder(lot_folder)
    assert list(folder.problems) == ["센서"] and folder.problems["센서"].code == "name.twice"


def test_a_source_that_two_files_name_stops_the_lot(lot_folder: Path) -> None:
    pd.read_csv(lot_folder / "source/A0.csv").to_parquet(lot_folder / "source/A0.parquet")
    with pytest.raises(InputError, match=r"A0\.csv, A0\.parquet"):
        open_lot_folder(lot_folder)


def test_audits_without_a_serial_are_remarked_and_not_used(lot_folder: Path) -> None:
    (lot_folder / "audit/A1.csv").rename(lot_folder / "audit/A 1.csv")
    folder = open_lot_folder(lot_folder)
    assert any("A 1.csv" in remark for remark in folder.remarks)
    assert sorted(folder.audit_paths) == ["A2", "A3"]


def test_tables_without_a_serial_are_all_named_at_once_and_imported_as_rows(
    tmp_path: Path, lot_folder: Path, registry_url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "more").mkdir()
    tables = {"A0": "source/A0", "A1": "units/A1", "A 2": "units/A2", "x?y": "units/A3", "more/A1": "units/A2"}
    for name, path in tables.items():
        shutil.copy(lot_folder / f"{path}.csv", tmp_path / f"{name}.csv")
    files = [str(tmp_path / f"{name}.csv") for name in tables]
    options = ("--source", "A0", "--reference-column", "reference", "--out", str(tmp_path / "imported"))
    assert main(["import", *files, *options]) == 0
    notes = capsys.readouterr().err
    assert all(name in notes for name in ("U+0020 SPACE", "U+003F QUESTION MARK", "more/A1.csv"))
    units = open_lot_folder(tmp_path / "imported")
    assert len(units.unit_paths) == 4 and units.problems.keys() == units.unit_paths.keys()
    assert all(not set(path.name) & set('<>:"/\\|?*') for path in units.unit_paths.values())


def test_a_wide_table_names_no_file_outside_its_lot(tmp_path: Path, lot_folder: Path) -> None:
    table = pd.read_csv(lot_folder / "source/A0.csv")
    table["u/../../x"] = table["u1"] = table.output
    table.rename(columns={"output": "u0"}).to_csv(tmp_path / "wide.csv", index=False)
    options = ("--output-column", "u*", "--source", "u0", "--reference-column", "reference")
    assert main(["import", str(tmp_path / "wide.csv"), *options, "--out", str(tmp_path / "imported")]) == 0
    folder = open_lot_folder(tmp_path / "imported")
    assert len(folder.unit_paths) == 2 and len(folder.problems) == 1
    assert not (tmp_path / "x.csv").exists()
