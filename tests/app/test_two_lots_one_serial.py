"""Two lots with equal serials: every page, link, command, path, topic and file means the unit of one lot."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from streamlit.testing.v1 import AppTest

from softcal.app.cli.main import main
from softcal.app.line.station_gate import check_golden
from softcal.app.registry.golden import golden_lot, newest_golden
from softcal.app.registry.lot_recordings import newest_audits
from softcal.app.registry.quality import golden_charts, lot_yields
from softcal.app.registry.unit import calibrated_unit
from softcal.app.texts.catalogue import text
from softcal.app.views.search import search
from softcal.app.views.station import golden_units
from softcal.core.errors import AmbiguousUnit
from softcal.core.lot import UnitKey
from softcal.core.recording import LabelledRecording
from softcal.core.unit.estimate import estimate
from softcal.db.connection import open_registry
from softcal.db.entries import GoldenRun
from tests.unit_states import audit_of, state_of

pytestmark = pytest.mark.usefixtures("separate_data_folder")
SERIAL = "A1"
SMALL, OTHER = UnitKey("small", SERIAL), UnitKey("other", SERIAL)
LOTS = ("small", "other")
PASS, FAIL = (text("en", f"verdict.{word}") for word in ("pass", "fail"))


@pytest.fixture
def twins(calibrated: str) -> str:
    """URL of a registry in which A1 of lot `small` passed and A1 of lot `other` failed, its recording 0.3 V higher."""
    with open_registry(calibrated) as registry:
        mine = registry.calibrations.get(SERIAL).state
        recording = registry.recordings.get(mine.fit.recording_sha256)
        recording = getattr(recording, "unlabelled", recording)
        registry.lots.add(replace(registry.lots.get("small"), id="other", limit_rmse=2.0))
        sha256 = registry.recordings.add("other", replace(recording, output=recording.output + 0.3), "unit")
        failed = state_of(SERIAL, mine.fit.network_id, sha256, verdict="fail")
        failed = replace(failed, audit=audit_of(failed, 3.0, 2.9))
        registry.calibrations.add("other", failed)
        assert mine.verdict == "pass" and failed.verdict == "fail"
    return calibrated


@pytest.fixture
def links(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, dict[str, str]]]:
    """The pages that links opened, each with its query."""
    opened: list[tuple[str, dict[str, str]]] = []
    name = "softcal.app.ui.components.unit_table.go_to"
    monkeypatch.setattr(name, lambda page, **query: opened.append((page, query)))
    return opened


def badge(screen: AppTest) -> str:
    assert not screen.error and not screen.exception
    return " ".join(element.proto.body for element in screen.get("html") if "status" in element.proto.body)


@pytest.mark.parametrize(("key", "verdict"), [(SMALL, PASS), (OTHER, FAIL)], ids=str)
def test_a_link_opens_the_unit_of_its_lot(twins, show, key, verdict):
    assert verdict in badge(show(twins, "unit", unit=str(key)))


@pytest.mark.parametrize("lot", ["small", "other"])
def test_the_table_of_a_lot_links_to_its_own_units(twins, show, links, monkeypatch, lot):
    monkeypatch.setattr("softcal.app.ui.components.unit_table.table_to_choose", lambda rows, *_: 0)
    screen = show(twins, "lot", tab="units", lot=lot)
    assert not screen.error
    assert links and all(UnitKey.parse(query["unit"]).lot_id == lot for _, query in links)


def test_a_serial_alone_is_asked_for_with_its_lot_and_never_guessed(twins, show):
    screen = show(twins, "unit", unit=SERIAL)
    assert badge(screen) == ""
    links = " ".join(screen.table[0].value.iloc[:, 0])
    assert len(screen.table[0].value) == 2 and "small%2FA1" in links and "other%2FA1" in links


def test_a_serial_of_one_lot_needs_no_lot(twins, show):
    assert not show(twins, "unit", unit="A3").error


def test_the_search_offers_the_units_of_both_lots(twins):
    with open_registry(twins) as registry:
        assert {hit.query["unit"] for hit in search(registry, SERIAL)} == {str(SMALL), str(OTHER)}


@pytest.mark.parametrize("key", [SMALL, OTHER], ids=str)
def test_the_files_and_the_revisions_of_the_page_are_those_of_its_lot(twins, show, key):
    screen = show(twins, "unit", tab="files", unit=str(key))
    screen.segmented_control(key=f"format-{key}").set_value("pdf").run()
    assert not screen.error
    keys = [button.key for button in screen.get("download_button") if "certificate" in str(button.proto.label)]
    assert keys
    with open_registry(twins) as registry:
        revision = registry.calibrations.get(SERIAL, lot_id=key.lot_id).revision
    assert all(f"-{revision}-" in str(name) for name in keys)


def test_two_units_of_equal_serials_are_compared(twins, show):
    screen = show(twins, "unit", tab="compare", unit=str(SMALL), **{"with": str(OTHER)})
    (table,) = screen.table
    text = table.value.to_string()
    assert PASS in text and FAIL in text
    assert [str(SMALL), str(OTHER)] == list(table.value.columns)[1:]


STEP = {"stream": "s", "sample": 1, "t_s": 0.0, "event": "follow", "verdict": "ok", "alarm": "", "shift": 0.1}


def step(alarm: str, predicted_rmse: float) -> dict[str, object]:
    return STEP | {"alarm": alarm, "predicted_rmse": predicted_rmse, "gain": 1.0, "offset": 0.0, "output": 0.5}


def test_what_was_followed_of_one_unit_is_not_told_of_the_other(twins):
    with open_registry(twins) as registry:
        registry.adaptations.add(SMALL, 1, [step("", 0.1)])
        registry.adaptations.add(OTHER, 2, [step("range", 0.7)])
        assert {unit.key: unit.steps for unit in registry.adaptations.units()} == {SMALL: 1, OTHER: 1}
        for key, revision, error in ((SMALL, 1, 0.1), (OTHER, 2, 0.7)):
            assert [entry["predicted_rmse"] for entry in registry.adaptations.all(key)] == [error]
            assert registry.adaptations.last(key, revision, "s")["predicted_rmse"] == error


COMMANDS = {
    "explain": ("explain",),
    "estimate": ("estimate", "{recording}", "--out", "{out}.csv"),
    "adapt": ("adapt", "{recording}", "--out", "{out}.csv"),
    "trim": ("trim", "--loads", "{loads}", "--yes"),
    "history": ("registry", "history"),
    "rollback": ("registry", "rollback", "--to", "1", "--reason", "because it was asked", "--yes"),
    "export": ("export", "--format", "pdf", "--out", "{out}"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_names_the_option_that_says_which_lot(twins, trained_lot, tmp_path, capsys, name):
    (tmp_path / "loads.csv").write_text("output,reference\n0.5,0\n0.9,2\n")
    files = {"recording": trained_lot / "lot/units/A1.csv", "loads": tmp_path / "loads.csv", "out": tmp_path / "out"}
    arguments = [word.format(**files) for word in COMMANDS[name]]
    assert main([*arguments, "--serial", SERIAL, "--registry", twins]) == 2
    error = capsys.readouterr().err
    assert "--lot" in error and "small" in error and "other" in error


@pytest.mark.parametrize("name", ["explain", "history"])
@pytest.mark.parametrize(("key", "verdict"), [(SMALL, "pass"), (OTHER, "fail")], ids=str)
def test_a_command_with_the_lot_answers_for_that_unit(twins, capsys, name, key, verdict):
    assert main([*COMMANDS[name], "--serial", SERIAL, "--lot", key.lot_id, "--registry", twins]) == 0
    out = capsys.readouterr().out
    assert verdict in out and ({"pass", "fail"} - {verdict}).isdisjoint(out.split())


def export(url: str, key: UnitKey, out, *more: str) -> int:
    arguments = ["export", "--registry", url, "--serial", key.serial, "--lot", key.lot_id, "--out", str(out)]
    return main([*arguments, "--format", "json", "--failed-too", *more])


def test_a_folder_with_a_unit_of_another_lot_is_left_as_it_is(twins, tmp_path, capsys):
    out = tmp_path / "files"
    assert export(twins, SMALL, out) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    capsys.readouterr()
    assert export(twins, OTHER, out) == 2
    error = capsys.readouterr().err
    assert str(SMALL) in error and str(OTHER) in error
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert export(twins, SMALL, out) == 0


def test_a_batch_takes_no_files_of_another_lot_back(twins, tmp_path):
    from softcal.app.export.manifest import withdraw_units

    out = tmp_path / "files"
    assert export(twins, SMALL, out) == 0
    assert withdraw_units(out, "other", [], {SERIAL: "fail"}) == []
    assert (out / f"unit-{SERIAL}.json").exists()
    assert withdraw_units(out, "small", [], {SERIAL: "fail"}) == [SERIAL]


def test_the_topic_of_live_estimates_names_the_lot(twins, monkeypatch):
    from softcal.app.connect import mqtt

    messages: list[tuple[str, str, bool]] = []

    class Broker:
        def __init__(self, settings: object) -> None: ...
        def __enter__(self) -> "Broker":
            return self

        def __exit__(self, *_: object) -> None: ...
        def publish(self, message: tuple[str, str, bool]) -> bool:
            messages.append(message)
            return True

    monkeypatch.setattr(mqtt, "_Live", Broker)
    for key in (SMALL, OTHER):
        mqtt.publish_estimates([mqtt.HEADER, "0.0,1.0,0.9,1.1,"], key, None, 1e9)
    assert [topic for topic, *_ in messages] == [f"lots/{lot}/units/{SERIAL}/estimate" for lot in ("small", "other")]
    assert [json.loads(payload)["lot"] for _, payload, _ in messages] == ["small", "other"]


@pytest.mark.parametrize("word", ["small/A1", "로트 1+/가-1", "a.b c/A_1.x"])
def test_a_key_reads_back_from_its_text(word):
    key = UnitKey.parse(word)
    assert str(key) == word and key == UnitKey(*word.split("/"))


def test_a_golden_unit_is_checked_with_the_map_of_its_lot(twins):
    with open_registry(twins) as registry:
        (entry, *_) = registry.recordings.of_lot("small", kind="source")
        recording = registry.recordings.get(entry.sha256)
        assert isinstance(recording, LabelledRecording)
        recording = replace(recording, unlabelled=replace(recording.unlabelled, serial=SERIAL))
        with pytest.raises(AmbiguousUnit):
            check_golden(registry, "line-1", recording)
        runs = {
            key: check_golden(registry, f"line-{key.lot_id}", recording, lot_id=key.lot_id) for key in (SMALL, OTHER)
        }
        for key, run in runs.items():
            unit = calibrated_unit(registry, SERIAL, lot_id=key.lot_id)[1:]
            error = estimate(*unit, recording.unlabelled).estimate - recording.reference
            assert run.value == pytest.approx(float(np.sqrt(np.nanmean(error**2))))
    assert runs[SMALL].value != pytest.approx(runs[OTHER].value)


NOW = datetime.now(UTC)


def checked(lot_id: str, serial: str = SERIAL, passed: bool = True, **more) -> GoldenRun:
    return GoldenRun("line-1", lot_id, serial, NOW, 0.1, "N", passed, **more)


def test_a_golden_unit_of_one_lot_takes_no_unit_of_another_out(twins):
    with open_registry(twins) as registry:
        recording = registry.recordings.get(registry.recordings.of_lot("small", kind="source")[0].sha256)
        recording = replace(recording, unlabelled=replace(recording.unlabelled, serial=SERIAL))
        registry.recordings.add("other", recording, "audit")
        registry.stations.add_golden_run(checked("small"))
        assert set(newest_audits(registry, "other")) == {SERIAL} and SERIAL not in newest_audits(registry, "small")
        units = {lot: len({run.serial for run in registry.lots.runs(lot)}) for lot in LOTS}
        counted = {lot: lot_yields(registry, lot).last_pass.of for lot in LOTS}
        assert counted == {"small": units["small"] - 1, "other": units["other"]}


def test_units_are_pressed_beside_the_golden_run_of_their_own_source(twins):
    with open_registry(twins) as registry:
        source = registry.recordings.get(registry.recordings.of_lot("small", kind="source")[0].sha256)
        other = replace(source, unlabelled=replace(source.unlabelled, output=source.unlabelled.output + 0.3))
        registry.lots.add(replace(registry.lots.get("small"), id="same"))
        registry.recordings.add("same", source, "source")
        registry.recordings.add("other", other, "source")
        registry.stations.add_golden_run(checked("small", "A0", recording_sha256="f" * 64))
        golden_runs = {
            lot: newest_golden(registry, "line-1", lot, NOW - timedelta(hours=1)) for lot in registry.lots.ids()
        }
    assert golden_runs == {"small": "f" * 64, "same": "f" * 64, "other": None}


def test_a_golden_order_that_two_sources_fit_asks_for_the_lot(twins):
    with open_registry(twins) as registry:
        source = registry.recordings.get(registry.recordings.of_lot("small", kind="source")[0].sha256)
        other = replace(source, unlabelled=replace(source.unlabelled, output=source.unlabelled.output + 0.3))
        network = registry.networks.released("small").network.id
        registry.recordings.add("other", other, "source")
        another = replace(registry.networks.get(network), output_mean=0.7)
        trained_on = {"source_recording_sha256": other.sha256}
        registry.networks.add("other", another, {}, trained_on, "e" * 64)
        assert golden_lot(registry, "A0", "small") == "small" and golden_lot(registry, "A0", "other") == "other"
        with pytest.raises(AmbiguousUnit, match="name the lot"):
            golden_lot(registry, "A0")


def test_golden_units_of_two_lots_have_a_chart_each(twins):
    with open_registry(twins) as registry:
        for number in range(8):
            for lot in ("small", "other"):
                registry.stations.add_golden_run(replace(checked(lot), made_at=NOW + timedelta(hours=number)))
        assert set(golden_charts(registry, "line-1", SERIAL, None)) == {("line-1", lot, SERIAL) for lot in LOTS}
        assert [(unit.lot_id, len(unit.runs)) for unit in golden_units(registry)] == [("other", 8), ("small", 8)]
