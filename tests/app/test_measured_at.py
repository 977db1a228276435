"""When an audit was measured: by its own stamps, as stated, kept with the lot; and what a draw says of it."""

import json
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.calibration.audit import audited_sample
from softcal.app.cli.main import main
from softcal.app.registry.lot_recordings import newest_audits
from softcal.db.connection import open_registry

SMALL = ("--hidden", "16,8", "--no-own")
DAY = timedelta(days=1)


@pytest.fixture
def somewhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A computer nine hours ahead of UTC."""
    monkeypatch.setenv("TZ", "KST-9")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def stamp(path: Path, start: datetime, zone: str = "") -> Path:
    """Give a recording absolute stamps in place of its seconds."""
    table = pd.read_csv(path)
    at = pd.Timestamp(start.replace(tzinfo=None)) + pd.to_timedelta(table.pop("t_s"), unit="s")
    table.insert(0, "time", at.dt.strftime("%Y-%m-%d %H:%M:%S.%f") + zone)
    table.to_csv(path, index=False)
    return path


def run_command(tmp_path: Path, *arguments: str) -> tuple[int, dict]:
    file = tmp_path / "answer.json"
    file.unlink(missing_ok=True)
    code = main([*arguments, "--json", str(file)])
    return code, json.loads(file.read_text()) if file.exists() else {}


@pytest.fixture
def drawn_lot(make_lot: Callable[..., Path], registry_url: str, tmp_path: Path) -> tuple[Path, list[Path]]:
    """A calibrated lot whose units were drawn, and the recordings of ten of them, not brought yet."""
    folder, away = make_lot(), tmp_path / "measured"
    (folder / "audit").rename(away)
    main(["batch", str(folder), "--registry", registry_url, *SMALL])
    assert main(["lot", "audit-plan", str(folder), "--random", "99", "--registry", registry_url]) == 0
    return folder, sorted(away.iterdir())


@pytest.mark.long
@pytest.mark.parametrize("by", ["stated", "stamps", "stamps in the folder"])
@pytest.mark.parametrize("is_since", [True, False])
def test_a_sample_measured_before_its_draw_releases_nobody(by, is_since, drawn_lot, registry_url, tmp_path, capsys):
    folder, audits = drawn_lot
    at = datetime.now(UTC) if is_since else datetime.now(UTC) - 2 * DAY
    bring = ["lot", "audit", str(folder), *map(str, audits), "--registry", registry_url]
    if by == "stated":
        bring += ["--measured-at", at.isoformat()]
    else:
        for path in audits:
            stamp(path, at, "Z")
    if by == "stamps in the folder":
        (folder / "audit").mkdir()
        for path in audits:
            path.rename(folder / "audit" / path.name)
    else:
        assert main(bring) == 0
    _, report = run_command(tmp_path, "batch", str(folder), "--registry", registry_url, *SMALL)
    unmeasured = {unit["verdict"] for unit in report["units"] if not unit["audited"]}
    assert unmeasured == ({"pass"} if is_since else {"conditional"})
    capsys.readouterr()
    _, release = run_command(tmp_path, "lot", "release", "large", "--registry", registry_url)
    sample = release["sample"]
    assert (sample["since"], sample["before"], sample["without_draw"]) == ((10, 0, 0) if is_since else (0, 10, 0))
    assert sample["drawn"] == 14 and sample["drawn_at"].startswith(str(datetime.now(UTC).year))
    main(["lot", "release", "large", "--registry", registry_url])
    stdout = capsys.readouterr().out
    assert f"measured since {sample['since']}, before {sample['before']}, without a draw 0" in stdout


def test_an_imported_audit_keeps_its_instant_through_folder_registry_and_back(
    lot_folder, registry_url, tmp_path, somewhere, capsys
):
    started = datetime(2026, 3, 1, 18, 22, 5, tzinfo=UTC)
    files = []
    for name, part in (("A0", "source"), ("A1", "audit"), ("A2", "audit")):
        (copy := tmp_path / f"{name}.csv").write_bytes((lot_folder / part / f"{name}.csv").read_bytes())
        files.append(copy)
    stamp(files[1], started, "+00:00")
    stamp(files[2], started)
    new_folder = tmp_path / "made"
    arguments = ["import", *map(str, files), "--source", "A0", "--sample-rate", "50", "--audit"]
    arguments += ["--reference-column", "reference", "--limit", "5", "--out", str(new_folder)]
    assert main(arguments) == 0
    stderr = capsys.readouterr().err
    assert stderr.count("local time of this computer") == 1
    assert main(["batch", str(new_folder), "--registry", registry_url, *SMALL]) in (0, 1)
    expected = {"A1": started, "A2": started - timedelta(hours=9)}
    with open_registry(registry_url) as registry:
        instants = {serial: entry.measured_at for serial, entry in newest_audits(registry, "made").items()}
    assert instants == expected
    assert main(["lot", "folder", "made", "--registry", registry_url, "--out", str(tmp_path / "again")]) == 0
    other = f"sqlite:///{tmp_path / 'other.db'}"
    assert main(["batch", str(tmp_path / "again"), "--registry", other, *SMALL]) in (0, 1)
    with open_registry(other) as registry:
        assert {s: entry.observed_at for s, entry in newest_audits(registry, "made").items()} == expected
    # The very folder again contradicts nothing.
    assert main(["batch", str(tmp_path / "again"), "--registry", registry_url, *SMALL]) in (0, 1)
    with open_registry(registry_url) as registry:
        assert {s: entry.observed_at for s, entry in newest_audits(registry, "made").items()} == expected


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("time", lambda t: (1772389325 + t).map("{:.3f}".format)),
        ("time_ms", lambda t: (1772389325000 + 1000 * t).round().astype("int64")),
        ("ticks", lambda t: 134168629250000000 + (t * 100).round().astype("int64") * 100000),
        ("time", lambda t: (pd.Timestamp("2026-03-02 03:22:05") + pd.to_timedelta(t, unit="s")).astype(str)),
        ("time", lambda t: (pd.Timestamp("2026-03-01 18:22:05Z") + pd.to_timedelta(t, unit="s")).astype(str)),
        ("utc", lambda t: (pd.Timestamp("2026-03-01 18:22:05") + pd.to_timedelta(t, unit="s")).astype(str)),
    ],
)
def test_every_kind_of_absolute_stamp_reaches_the_recording(column, cells, calibrated, lot_folder, tmp_path, somewhere):
    table = pd.read_csv(lot_folder / "audit/A1.csv")
    t = table.pop("t_s")
    table["reference"] += 0.001
    table.insert(0, column, cells(t))
    table.to_csv(tmp_path / "A1.csv", index=False)
    bring = ["lot", "audit", "small", str(tmp_path / "A1.csv"), "--registry", calibrated]
    assert main([*bring, "--time-column", column]) == 0
    with open_registry(calibrated) as registry:
        at = newest_audits(registry, "small")["A1"].measured_at
    assert at is not None and abs(at - datetime(2026, 3, 1, 18, 22, 5, tzinfo=UTC)) < timedelta(seconds=1)


def test_parquet_keeps_the_zone_of_its_stamps(calibrated, lot_folder, tmp_path, somewhere):
    at = pd.Timestamp("2026-03-01 18:22:05Z")
    zones = (("UTC", at), ("Europe/Berlin", at), (None, at - timedelta(hours=9)))
    for number, (zone, expected) in enumerate(zones, 1):
        table = pd.read_csv(lot_folder / "audit/A1.csv")
        table["reference"] += 0.001 * number
        times = at + pd.to_timedelta(table.pop("t_s"), unit="s")
        table.insert(0, "time", times.dt.tz_convert(zone) if zone else times.dt.tz_localize(None))
        table.to_parquet(tmp_path / "A1.parquet")
        with open_registry(calibrated) as registry:
            registry_before = newest_audits(registry, "small").get("A1")
        assert main(["lot", "audit", "small", str(tmp_path / "A1.parquet"), "--registry", calibrated]) == 0
        with open_registry(calibrated) as registry:
            entry = newest_audits(registry, "small")["A1"]
        assert entry != registry_before and entry.measured_at == expected.to_pydatetime()


@pytest.mark.parametrize("instant", ["yesterday", "2026-13-01", "0026-11-01", "", "2999-01-01", "99999-01-01"])
def test_nonsense_and_the_future_are_refused_in_one_line(instant, calibrated, lot_folder, capsys):
    file = str(lot_folder / "audit/A1.csv")
    assert main(["lot", "audit", "small", file, "--registry", calibrated, "--measured-at", instant]) == 2
    stderr = capsys.readouterr().err
    assert stderr.count("\n") == 1 and "--measured-at" in stderr and (not instant or instant in stderr)


@pytest.mark.parametrize("is_folder", [True, False])
def test_a_files_own_stamp_outranks_what_is_stated_and_contradicts_it(
    is_folder, calibrated, lot_folder, tmp_path, capsys
):
    started = datetime(2026, 3, 1, 18, 22, 5, tzinfo=UTC)
    (file := tmp_path / "A1.csv").write_bytes((lot_folder / "audit/A1.csv").read_bytes())
    stamp(file, started, "Z")
    lot = str(lot_folder) if is_folder else "small"
    bring = ["lot", "audit", lot, str(file), "--registry", calibrated, "--measured-at"]
    before = (lot_folder / "lot.toml").read_text()
    code, answer = run_command(tmp_path, *bring, "2026-03-05")
    assert code == 2 and answer["audited"] == [] and "2026-03-01" in next(iter(answer["refused"].values()))
    assert (lot_folder / "lot.toml").read_text() == before
    # The day of the stamp, at its beginning.
    if is_folder:
        assert main([*bring, "2026-03-01T00:00Z"]) == 0
        assert "2026-03-01 18:22:05" in (lot_folder / "lot.toml").read_text().replace("T", " ")


def test_an_audit_that_is_replaced_does_not_keep_the_instant_of_the_other(lot_folder, tmp_path):
    (file := tmp_path / "A1.csv").write_bytes((lot_folder / "audit/A1.csv").read_bytes())
    assert main(["lot", "audit", str(lot_folder), str(file), "--measured-at", "2026-03-01"]) == 0
    assert "A1" in (lot_folder / "lot.toml").read_text()
    assert main(["lot", "audit", str(lot_folder), str(file)]) == 0
    assert "A1" not in (lot_folder / "lot.toml").read_text()


def test_stamps_of_the_future_are_refused_and_a_clock_that_was_never_set_says_nothing(calibrated, lot_folder, tmp_path):
    for start, is_taken in ((datetime.now(UTC) + 3 * DAY, False), (datetime(1970, 1, 1, tzinfo=UTC), True)):
        (file := tmp_path / "A2.csv").write_bytes((lot_folder / "audit/A2.csv").read_bytes())
        stamp(file, start, "Z")
        code, answer = run_command(tmp_path, "lot", "audit", "small", str(file), "--registry", calibrated)
        assert (answer["audited"] == ["A2"]) is is_taken and (code == 0) is is_taken


def test_nobody_makes_a_known_recording_younger_or_older(calibrated, lot_folder, tmp_path, capsys):
    with open_registry(calibrated) as registry:
        serial, entry = next(iter(newest_audits(registry, "small").items()))
        first = audited_sample(registry, "small")
    file = next(path for path in (lot_folder / "audit").iterdir() if path.stem == serial)
    bring = ["lot", "audit", "small", str(file), "--registry", calibrated, "--measured-at", "2026-03-01"]
    assert main(bring) == 2
    assert serial in (stderr := capsys.readouterr().err) and "Traceback" not in stderr
    with open_registry(calibrated) as registry:
        assert newest_audits(registry, "small")[serial] == entry and audited_sample(registry, "small") == first


def test_lot_toml_with_an_instant_that_is_none_is_refused_in_one_line(lot_folder, registry_url, capsys):
    toml = (lot_folder / "lot.toml").read_text()
    for value in ('"soon"', "7", "2999-01-01", "[]"):
        (lot_folder / "lot.toml").write_text(f"{toml}\n[audit]\nA1 = {value}\n")
        capsys.readouterr()
        assert main(["batch", str(lot_folder), "--registry", registry_url, *SMALL]) == 2
        stderr = capsys.readouterr().err
        assert stderr.count("\n") == 1 and "[audit] A1" in stderr
