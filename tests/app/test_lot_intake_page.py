"""From an empty registry to files in hand without a terminal: the pages, the jobs behind them, and what they refuse."""

import io
import shutil
import zipfile
from datetime import date
from pathlib import Path

import pytest

from softcal.app.batch import lot_intake
from softcal.app.batch.lot_intake import lot_files, lots_folder, network_of
from softcal.app.calibration.changes import Changes, VerdictChange, change_limit
from softcal.app.export.check import check_folder
from softcal.app.export.laboratory import Laboratory, registry_laboratory
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.jobs.jobs import archive_path, run_job
from softcal.app.texts.catalogue import text
from softcal.app.ui.tabs import lot_release
from softcal.core.messages.reason import Reason
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import RunState
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate
from tests.app.pdf_text import read_text

pytestmark = pytest.mark.usefixtures("separate_data_folder")


def button(screen, key: str):
    """Return the button that bears a text of the catalogue, or None."""
    return next((one for one in screen.button if one.label == text("en", key)), None)


def do_job(url: str, kind: str, request: dict[str, object]):
    """Do one job and return it with what it left."""
    with open_registry(url) as registry:
        job_id = registry.job_board.place(kind, request, "Erin")
        state = run_job(registry, job_id, lambda: None)
        job = registry.job_board.job(job_id)
        assert state is RunState.DONE, job.message
        return job


def test_an_empty_registry_begins_at_the_start_page_for_everybody(tmp_path: Path, open_page) -> None:
    screen = open_page(f"sqlite:///{tmp_path / 'new.db'}")
    assert screen.title[0].value == text("en", "page.lots")
    assert button(screen, "start.demo")


def test_the_ways_to_begin_give_way_to_the_table_once_there_is_a_lot(calibrated: str, show) -> None:
    screen = show(calibrated, "lots")
    assert not button(screen, "start.demo") and button(screen, "lots.new") and len(screen.table[0].value) == 1


@pytest.fixture
def demo_lot(trained_lot: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The demo presses a small lot that is there; how many units it was asked for."""
    presses: list[int] = []

    def press(config, folder: Path, on_run):
        presses.append(config.units)
        shutil.copytree(trained_lot / "lot", folder)
        (folder / "lot.toml").write_text((folder / "lot.toml").read_text().replace('"small"', '"demo"'))
        on_run("source")
        return open_lot_folder(folder)

    monkeypatch.setattr("softcal.app.line.demo.press_demo_lot", press)
    return presses


@pytest.mark.long
def test_the_demo_ends_on_the_page_of_its_lot_for_who_is_alone(
    tmp_path: Path, demo_lot: list[int], open_page, jobs_at_once: None
) -> None:
    url = f"sqlite:///{tmp_path / 'new.db'}"
    screen = open_page(url)
    screen.button(key="demo").click().run(timeout=300)
    with open_registry(url) as registry:
        assert registry.lots.ids() == ["demo"] and demo_lot == [4]
        decided_units = sum(
            count for verdict, count in registry.pages.verdict_counts("demo").items() if verdict != "none"
        )
    assert not screen.exception and screen.title[0].value == text("en", "page.lot")
    assert screen.selectbox(key="choose-lot").value == "demo"
    assert decided_units and f"{decided_units} / {decided_units}" in {metric.value for metric in screen.metric}
    # Whoever comes back finds it, and the other ways to begin beside it.
    assert {"demo-open", "start-files"} <= {button.key for button in open_page(url).button}


def dropped(folder: Path) -> list[tuple[str, bytes, str]]:
    """Return the small lot as files a person would drop: audits carry their reference, the source too."""
    files = [("A0.csv", (folder / "source/A0.csv").read_bytes(), "text/csv")]
    files += [(f"A{k}.csv", (folder / f"audit/A{k}.csv").read_bytes(), "text/csv") for k in (1, 2)]
    return files


def test_dropped_files_become_a_calibrated_lot_and_what_is_broken_is_left_out_with_its_reason(
    tmp_path: Path, lot_folder: Path, show, jobs_at_once: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lot_intake, "network_of", lambda *_: NetworkConfig(hidden=(8,), max_epochs=5))
    deleted: list[str] = []
    url = f"sqlite:///{tmp_path / 'new.db'}"
    screen = show(url, "lots", tab="files")
    broken = ("A3.csv", b"t_s,output\n0,1\n0.02,abc\n", "text/csv")
    empty = ("../../A4.csv", b"", "text/csv")
    screen.file_uploader[0].set_value([*dropped(lot_folder), broken, empty]).run()
    assert not screen.exception and not screen.error
    screen.text_input(key="new-lot-name").set_value("mine").run()
    rows = screen.table[0].value
    why = {row.iloc[0]: row.iloc[-1] for _, row in rows.iterrows()}
    assert "abc" in why["A3.csv"] and why["A4.csv"] and str(tmp_path) not in why["A4.csv"]
    monkeypatch.setattr("streamlit.switch_page", lambda page, **_: deleted.append(page.url_path))
    button(screen, "new_lot.do").click().run(timeout=300)
    assert not screen.exception and not screen.error and deleted == ["lot"]
    with open_registry(url) as registry:
        counts = registry.pages.verdict_counts("mine")
        assert sum(counts.values()) == 2 and counts["none"] == 0
        assert {run.serial for run in registry.lots.runs("mine")} == {"A1", "A2"}
        assert all(registry.calibrations.get(serial).state.errors["after_rmse"] is not None for serial in ("A1", "A2"))
        assert registry.trail.rows()[0].actor in ("Erin", "test")


def test_a_lot_that_the_registry_knows_is_not_written_over(
    calibrated: str, lot_folder: Path, show, jobs_at_once: None
) -> None:
    screen = show(calibrated, "lots", tab="files")
    screen.file_uploader[0].set_value(dropped(lot_folder)).run()
    screen.text_input(key="new-lot-name").set_value("small").run()
    button(screen, "new_lot.do").click().run()
    assert "small" in screen.error[0].value
    assert not list(lots_folder().iterdir())


def test_a_time_column_in_milliseconds_is_refused_with_what_to_do(tmp_path: Path, show, press_unit) -> None:
    table = press_unit(600, 1.0, 0.5, 1)
    table["t_s"] *= 1000
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", "lots", tab="files")
    content = table.to_csv(index=False).encode()
    screen.file_uploader[0].set_value([("A0.csv", content, "text/csv"), ("A1.csv", content, "text/csv")]).run()
    assert "0.05 Hz" in screen.error[0].value


def test_a_layout_that_nothing_tells_is_stated_on_the_page(tmp_path: Path, show, press_unit) -> None:
    table = press_unit(600, 1.0, 0.5, 1)
    table["t_s"] *= 1000
    lines = ["a,b,c", *(",".join(f"{value:.6g}" for value in row) for row in table.to_numpy())]
    lines[300] = lines[300].split(",")[0] + ",OL,1.0"
    content = "\n".join(["0,1,2", *lines[1:]]).encode()
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", "lots", tab="files")
    screen.file_uploader[0].set_value([("A0.csv", content, "text/csv"), ("A1.csv", content, "text/csv")]).run()
    assert screen.error and not screen.dataframe
    screen.number_input(key="new-lot-header-row").set_value(1).run()
    screen.text_input(key="new-lot-missing").set_value("OL; --").run()
    screen.text_input(key="new-lot-time-format").set_value("ms").run()
    screen.selectbox(key="new-lot-decimal").set_value(".").run()
    for key, value in (("new-lot-reference", "2"), ("new-lot-time", "0")):
        screen.selectbox(key=key).set_value(value).run()
    screen.selectbox(key="new-lot-output").set_value("1").run()
    screen.text_input(key="new-lot-name").set_value("stated").run()
    assert not screen.exception and not screen.error
    assert any("50 Hz" in caption.value for caption in screen.caption)
    assert screen.table[0].value.iloc[:, 2].tolist() == [599, 599]


def test_one_column_per_unit_is_taken_too(tmp_path: Path, show, press_unit) -> None:
    table = press_unit(600, 1.0, 0.5, 1).rename(columns={"output": "ch_1"})
    table["ch_2"], table["ch_3"] = table["ch_1"] * 1.1 + 0.02, 0.5
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", "lots", tab="files")
    screen.file_uploader[0].set_value([("wide.csv", table.to_csv(index=False).encode(), "text/csv")]).run()
    screen.radio[0].set_value("wide").run()
    assert screen.text_input(key="new-lot-pattern").value == "ch_*"
    assert screen.selectbox(key="new-lot-source").options == ["ch_1", "ch_2", "ch_3"]
    screen.text_input(key="new-lot-name").set_value("wide").run()
    will = {row.iloc[1].replace("\\", ""): (row.iloc[4], row.iloc[5]) for _, row in screen.table[0].value.iterrows()}
    assert will["ch_1"][0] == "source" and will["ch_2"][0] == "calibrated"
    assert will["ch_3"][0] == text("en", "new_lot.will.doubtful") and will["ch_3"][1]


def test_a_lot_that_is_calibrated_again_computes_nothing_anew(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        assert network_of(registry, "small").hidden == (16, 8)
    do_job(calibrated, "calibrate", {"lot": "small"})
    with open_registry(calibrated) as registry:
        before = {unit.serial: unit.revision for unit in registry.lots.units("small")}
    job = do_job(calibrated, "calibrate", {"lot": "small"})
    assert (job.result["new"], job.result["known"]) == (0, 4)
    with open_registry(calibrated) as registry:
        assert {unit.serial: unit.revision for unit in registry.lots.units("small")} == before


def test_a_lot_out_of_the_registry_has_the_recordings_bit_by_bit(calibrated: str) -> None:
    with open_registry(calibrated) as registry, lot_files(registry, "small", lambda *_: None) as folder:
        assert set(folder.unit_paths) == {"A1", "A2", "A3", "A4"}
        for serial in folder.unit_paths:
            (entry,) = registry.recordings.of_lot("small", serial, "unit")
            assert folder.read_unit(serial).sha256 == entry.sha256
        (source,) = registry.recordings.of_lot("small", kind="source")
        assert folder.read_source().sha256 == source.sha256


@pytest.mark.long
def test_the_archive_of_a_lot_is_whole_and_says_what_is_not_in_it(calibrated: str, tmp_path: Path) -> None:
    request = {"lot": "small", "serials": None, "formats": ["json", "pdf", "blob"], "release": "pass"}
    job = do_job(calibrated, "archive", request)
    with zipfile.ZipFile(io.BytesIO(archive_path(job).read_bytes())) as pack_reasons:
        pack_reasons.extractall(tmp_path / "files")
    report = check_folder(tmp_path / "files", None)
    assert not report.problems
    with open_registry(calibrated) as registry:
        passed = {u.serial for u in registry.lots.units("small") if u.verdict == "pass"}
        serials = {u.serial for u in registry.lots.units("small") if u.revision is not None and u.role == "target"}
        assert registry.trail.rows()[-1].actor == "Erin"
    names = {path.name for path in (tmp_path / "files").iterdir()}
    assert {name for name in names if name.endswith(".pdf")} and job.result["units"] == len(serials)
    assert {serial for serial, _ in job.result["refused"]} == serials - passed
    assert len([name for name in names if name.endswith(".ssc") and name.startswith("unit-")]) == len(passed)


def test_an_archive_is_offered_only_while_its_lot_is_as_it_was_packed(calibrated: str, show) -> None:
    do_job(calibrated, "archive", {"lot": "small", "serials": None, "formats": ["json"], "release": "pass"})

    def is_offered() -> bool:
        screen = show(calibrated, "lot", lot="small", tab="release")
        return any("archive" in button.key for button in screen.get("download_button"))

    assert is_offered()
    with open_registry(calibrated) as registry:
        change_limit(registry, "small", 1e-6, reason="another drawing")
    assert not is_offered()


def test_what_the_form_of_the_laboratory_says_stands_on_the_certificate(calibrated: str, show, tmp_path: Path) -> None:
    certificate = CellCertificate("LC-9", "K-1", "KRISS", date(2026, 1, 2), date(2027, 1, 2), 50.0, 0.05)
    with open_registry(calibrated) as registry:
        registry.stations.add_certificate(certificate, actor="test")
    screen = show(calibrated, "settings", tab="laboratory")
    form = {"laboratory-name": "Haptics Lab", "laboratory-country": "KR"}
    form |= {"customer-name": "Beispiel GmbH", "person-name": "Kim Ji-woo"}
    for field, typed in form.items():
        screen.text_input(key=f"laboratory-{field}").set_value(typed)
    screen.selectbox(key="laboratory-cell").set_value("LC-9")
    button(screen, "laboratory.save").click().run()
    assert screen.success and not screen.error
    with open_registry(calibrated) as registry:
        form = registry_laboratory(registry)
    assert (form.laboratory.name, form.load_cell.due_on) == ("Haptics Lab", date(2027, 1, 2))
    job = do_job(calibrated, "archive", {"lot": "small", "serials": ["A1"], "formats": ["pdf"], "release": "pass"})
    with zipfile.ZipFile(archive_path(job)) as pack_reasons:
        pdf = next(name for name in pack_reasons.namelist() if name.endswith(".pdf"))
        read = read_text(pack_reasons.read(pdf))
    assert all(word in read for word in ("Haptics Lab", "Beispiel GmbH", "Kim Ji-woo", "LC-9"))


def test_a_country_that_is_none_is_refused_and_nothing_is_kept(calibrated: str, show) -> None:
    screen = show(calibrated, "settings", tab="laboratory")
    screen.text_input(key="laboratory-laboratory-country").set_value("Korea")
    button(screen, "laboratory.save").click().run()
    assert "KR" in screen.error[0].value
    with open_registry(calibrated) as registry:
        assert registry_laboratory(registry) == Laboratory()


def test_a_lot_is_released_from_its_page_and_the_trail_says_so(calibrated: str, show, monkeypatch) -> None:
    change = VerdictChange("small", "A1", "conditional", "pass", Reason("reversed"))
    monkeypatch.setattr(lot_release, "cached_release_changes", lambda _: Changes((change,), {"pass": 1}))
    decided: list[str] = []
    monkeypatch.setattr(lot_release, "decide_lot", lambda _, lot_id, name: decided.append(f"{lot_id} {name}"))
    screen = show(calibrated, "lot", tab="release", lot="small")
    assert not screen.exception and not screen.error
    button(screen, "release.do").click().run()
    assert "small" in screen.success[0].value and decided == ["small Erin"]


def test_an_operator_sees_the_release_and_may_not_decide_it(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="release", role="operator", lot="small")
    assert not screen.exception
    assert not button(screen, "release.do")


def test_two_units_stand_side_by_side(calibrated: str, show) -> None:
    screen = show(calibrated, "unit", tab="compare", unit="A1", **{"with": "A3"})
    assert not screen.exception and not screen.error
    columns = list(screen.table[0].value.columns)
    assert columns[1:] == ["small/A1", "small/A3"]
    assert show(calibrated, "unit", tab="compare", unit="A1", lang="ko").tabs[-1].label == text("ko", "tab.compare")
