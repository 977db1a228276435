"""The audit of a lot from its page: draw, bring the recordings, see what they say; and the wall board."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.calibration.audit import lot_audit
from softcal.app.texts.catalogue import text
from softcal.app.views.alerts import Alert
from softcal.app.views.lot import lot_view
from softcal.app.views.wall import MAX_ALERTS, wall_view
from softcal.core.messages.reason import Reason
from softcal.core.orders import Heartbeat, StationState
from softcal.db.connection import open_registry

pytestmark = pytest.mark.usefixtures("separate_data_folder")


def translate(key: str, **values: object) -> str:
    return text("en", key, **values)


def serial_of(cell: str) -> str:
    """Return the serial that a link of a table shows."""
    return cell[1:].partition("]")[0]


def button(screen, key: str):
    return next((one for one in screen.button if one.label == translate(key)), None)


def test_a_plan_is_drawn_once_and_again_only_with_a_reason(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="audit", lot="small")
    button(screen, "audit.draw.do").click().run()
    assert not screen.exception and not screen.error
    with open_registry(calibrated) as registry:
        first = lot_audit(registry, "small")
        assert first is not None
    button(screen, "audit.draw.do").click().run()
    assert screen.warning[0].value == translate("reason.missing")
    with open_registry(calibrated) as registry:
        assert len(registry.declarations.draws("small")) == 1
    assert [serial_of(row.iloc[0]) for _, row in screen.table[0].value.iterrows()] == list(first.plan.serials)


@pytest.mark.long
def test_recordings_are_looked_at_and_what_cannot_audit_a_unit_says_why(
    calibrated: str, lot_folder: Path, show, jobs_at_once: None
) -> None:
    table = pd.read_csv(lot_folder / "audit/A1.csv")
    # The registry has the other; when that was measured stays.
    audit = table.assign(reference=table["reference"] + 0.001).to_csv(index=False).encode()
    plain = (lot_folder / "units/A2.csv").read_bytes()
    screen = show(calibrated, "lot", tab="audit", lot="small")
    files = [("A1.csv", audit, "text/csv"), ("A2.csv", plain, "text/csv"), ("X9.csv", audit, "text/csv")]
    screen.file_uploader[0].set_value(files).run()
    assert not screen.exception and not screen.error
    why = {row.iloc[0]: row.iloc[-1] for _, row in screen.table[-1].value.iterrows()}
    assert why["A1.csv"] == "" and "reference" in why["A2.csv"] and "X9" in why["X9.csv"]
    with open_registry(calibrated) as registry:
        audited_serials = {entry.serial for entry in registry.recordings.of_lot("small", kind="audit")}
    declared_day = datetime.now(UTC).date() - timedelta(days=3)
    screen.date_input[0].set_value(declared_day).run()
    next(one for one in screen.button if one.key == "audit-take").click().run(timeout=300)
    assert not screen.exception and not screen.error
    with open_registry(calibrated) as registry:
        assert {entry.serial for entry in registry.recordings.of_lot("small", kind="audit")} == audited_serials | {"A1"}
        entry = registry.recordings.of_lot("small", "A1", "audit")[-1]
        assert entry.measured_at is not None and entry.measured_at.astimezone().date() == declared_day
        assert registry.calibrations.get("A1", lot_id="small").state.errors["after_rmse"] is not None
        assert any(row.actor == "Erin" for row in registry.trail.rows())


def test_who_may_not_set_up_may_not_draw(calibrated: str, show) -> None:
    screen = show(calibrated, "lot", tab="audit", role="quality", lot="small")
    assert not screen.exception
    assert button(screen, "audit.draw.do") is None


def test_the_wall_tells_a_station_that_is_silent_from_one_that_is_well(calibrated: str) -> None:
    now = datetime.now(UTC)
    with open_registry(calibrated) as registry:
        registry.order_queue.write_heartbeat(Heartbeat("line-1", StationState.READY, now, process="a:1"))
        registry.order_queue.write_heartbeat(
            Heartbeat("line-2", StationState.READY, now - timedelta(minutes=1), process="a:2")
        )
        registry.order_queue.write_heartbeat(Heartbeat("line-3", StationState.OFF, now, process="a:3"))
        wall = wall_view(registry, lot_view(registry, "small"), (), translate, now)
    assert {(name, is_well) for name, _, is_well in wall.stations} == {("line-1", True), ("line-2", False)}


def test_the_wall_counts_what_the_lot_holds_and_leaves_no_alert_unsaid(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
        many = [Alert("golden", {"station": "s", "serial": "G", "at": "now"}, True)] * (MAX_ALERTS + 2)
        wall = wall_view(registry, view, many, translate)
    expected_counts = {word: count for word, count in view.counts.items() if word != "none"}
    assert {verdict: count for verdict, _, count in wall.verdicts} == expected_counts
    assert wall.alerts[-1][0] == translate("wall.more", count=2) and len(wall.alerts) == MAX_ALERTS + 1
    assert {chip.serial for chip in wall.chips} == {"A1", "A2", "A3", "A4"}


@pytest.mark.parametrize("language", ["en", "ko"])
def test_the_wall_is_drawn(calibrated: str, show, language: str) -> None:
    screen = show(calibrated, "line", wall="", role="operator", lot="small", lang=language)
    assert not screen.exception and not screen.error


def test_every_audited_unit_is_listed_and_a_suspect_one_is_confirmed_with_a_reason(
    calibrated: str, lot_folder: Path, show
) -> None:
    with open_registry(calibrated) as registry:
        audited = sorted(entry.serial for entry in registry.recordings.of_lot("small", kind="audit"))
        state = registry.calibrations.get(audited[0], lot_id="small").state
        suspect = replace(state, suspect_audit=Reason("doubt.gain", {"gain": 0.01, "usual": 1.0, "others": 5}))
        registry.calibrations.add("small", suspect, decided_by="release")
    screen = show(calibrated, "lot", tab="audit", lot="small")
    assert sorted(map(serial_of, screen.table[-2].value.iloc[:, 0])) == audited
    # Before the button: which unit gets another verdict by it.
    assert list(map(serial_of, screen.table[-1].value.iloc[:, 0])) == audited[:1]
    key = f"reason-text-confirm-small/{audited[0]}"
    submit = next(one for one in screen.button if one.label == translate("audit.confirm", serial=audited[0]))
    submit.click().run()
    with open_registry(calibrated) as registry:
        assert not registry.declarations.in_force("confirmed_audits", "small"), "a reason is needed"
    screen.text_input(key=key).set_value("pressed again by hand")
    next(one for one in screen.button if one.label == translate("audit.confirm", serial=audited[0])).click().run()
    assert not screen.exception and not screen.error
    with open_registry(calibrated) as registry:
        assert len(registry.declarations.in_force("confirmed_audits", "small")) == 1
        status = registry.pages.unit_statuses("small", audited)[audited[0]]
        assert status.verdict == state.verdict and status.calibration is not None
        assert status.calibration.state.decision.is_audited
