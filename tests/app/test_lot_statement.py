"""The one page on a lot, read back with a tool that is not ours."""

from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import pytest

from softcal.app.calibration.audit import Sample
from softcal.app.export.certificates.lot_statement import LotStatement, lot_statement_pdf
from softcal.app.texts.catalogue import text as text_of
from softcal.app.texts.reasons import render_reason
from softcal.core.lot import Lot
from softcal.core.messages.reason import plain, reason
from softcal.core.quality.lot_release import release_lot
from softcal.core.quality.lot_status import LotStatus, UnitInLot
from softcal.core.quality.qualification import Qualification
from softcal.core.quality.release import AuditedUnit
from softcal.core.unit.method import ReleaseConfig
from softcal.core.unit.verdict import Limit
from softcal.db.provenance import Provenance
from tests.app.pdf_text import read_pages

LOT, LIMIT = Lot("lot-1", "S0", 50.0, sensor_model="EG <3 mm>", limit_rmse=0.5), Limit("N", 0.5)


SAMPLE = Sample(10, 40, *[datetime(2026, 4, 2, tzinfo=UTC)] * 2, 3, 7, 4)


def make_statement(audits: list[AuditedUnit], units: int, waiting: int = 0, withdrawn: int = 0) -> LotStatement:
    """Return the facts of a lot with `units` released on its audits, without audits none."""
    source, why = ("this lot", plain("ten of this lot")) if audits else ("none", reason("part.no_lot"))
    qualification = Qualification(source, tuple(audits), 0 if audits else 6, why, tuple(audits))
    decided = release_lot({f"LONG-SERIAL-{k:05d}": 0.2 for k in range(units)}, qualification, LIMIT, ReleaseConfig())
    word = "pass" if audits else "conditional"
    open_, failed = (plain("another load was expected"),), (plain("its audit failed"),)
    in_lot = [
        *(UnitInLot(serial, word, ()) for serial in decided.forecasts),
        *(UnitInLot(f"WAITS-{k:05d}", "retest", open_) for k in range(waiting)),
        *(UnitInLot(f"GONE-{k:05d}", "fail", failed, had_passed=True) for k in range(withdrawn)),
    ]
    status = LotStatus("lot-1", in_lot, LIMIT, decided)
    provenance = Provenance(
        version="1.0",
        build="ef" * 20,
        method="cd" * 32,
        inputs={"network abababababab": "ab" * 32} | {f"audit of {one.serial}": "12" * 32 for one in audits},
        made_at="2026-05-01T09:00:00+00:00",
        actor="kim@line-2",
    )
    return LotStatement(LOT, status, decided, provenance, SAMPLE, "lot-1-20260501")


STATEMENT = make_statement([AuditedUnit(f"A{k}", 0.2, 0.2 + 0.005 * k, "lot-1") for k in range(10)], 30)

translate = partial(text_of, "en")


def _read(pdf: bytes) -> tuple[str, int]:
    pages = read_pages(pdf)
    return " ".join(" ".join(pages).split()), len(pages)


def test_one_page_says_what_is_promised_on_what_evidence_at_what_risk() -> None:
    text, pages = _read(lot_statement_pdf(STATEMENT))
    assert pages == 1
    sample_sentence = translate(
        "paper.drawn.is", drawn=10, population=40, day="2026-04-02", since=3, before=7, others=4
    )
    criterion_sentence = translate("paper.promise.is", risk=0.1, confidence=0.9)
    for one in (
        str(STATEMENT.decided.statement),
        translate("paper.given"),
        "EG <3 mm>",
        "0.5 N",
        sample_sentence,
        criterion_sentence,
        "SERIAL-00019",
    ):
        assert one in text, one
    # Nothing waits and nothing was withdrawn: no title says otherwise.
    assert translate("paper.withdrawn") not in text


@pytest.mark.parametrize("language", ["en", "ko"])
def test_a_large_lot_still_fits_one_page_and_says_what_is_left_out(language: str) -> None:
    audits = [AuditedUnit(f"LONG-AUDIT-{k:04d}", 0.2, 0.2 + 0.001 * k, f"lot-{k % 7}") for k in range(80)]
    lot_statement = make_statement(audits, 2000, waiting=300, withdrawn=50)
    text, pages = _read(lot_statement_pdf(lot_statement, partial(text_of, language)))
    assert pages == 1 and text_of(language, "paper.more", count=70) in text and "1980" in text
    assert "WAITS-00000" in text and "GONE-00000" in text and "300" in text


@pytest.mark.parametrize("language", ["en", "ko"])
def test_without_a_promise_the_page_says_so_in_the_language_of_the_reader(language: str) -> None:
    translate, lot_statement = partial(text_of, language), make_statement([], 5)
    text, pages = _read(lot_statement_pdf(lot_statement, translate))
    assert pages == 1
    title, origin = translate("paper.title", lot="lot-1"), render_reason(LIMIT.origin, translate)
    statement = render_reason(lot_statement.decided.statement, translate).partition(":")[0]
    for one in (title, translate("paper.not_given"), translate("paper.none"), origin, statement):
        assert one in text, one


def test_a_simulated_lot_is_marked_in_korean_and_no_character_of_its_name_breaks_the_page() -> None:
    korean = partial(text_of, "ko")
    lot = replace(LOT, id="로트 1+", sensor_model="모델\n2\x00", reference_unit="뉴턴", reference_quantity="힘\u200b")
    audits = [AuditedUnit("단위\t1", 0.2, 0.21, "로트\t2")]
    lot_statement = replace(make_statement(audits, 5), lot=lot, is_simulated=True, identifier="로트\t1")
    text, pages = _read(lot_statement_pdf(lot_statement, korean))
    assert pages == 1
    for one in (korean("paper.simulated"), "로트 1+", r"모델 2\x00", "뉴턴", "단위 1", "로트 2"):
        assert one.replace(" ", "") in text.replace(" ", ""), one


def test_equal_content_makes_equal_bytes() -> None:
    assert lot_statement_pdf(STATEMENT) == lot_statement_pdf(replace(STATEMENT))


def test_a_release_that_nobody_made_yet_is_neither_printed_nor_reported() -> None:
    """What would be decided promises units that are conditional until somebody decides it."""
    units = [replace(unit, verdict="conditional") for unit in STATEMENT.status.units]
    undecided = replace(STATEMENT, status=replace(STATEMENT.status, units=units))
    text, _ = _read(lot_statement_pdf(undecided))
    assert translate("paper.given") not in text.replace(translate("paper.not_given"), "") and "SERIAL-00019" not in text
    status_json, decided = undecided.status.to_json(), STATEMENT.status.to_json()
    assert (status_json["released"], status_json["statement"], status_json["statement_reason"]) == ([], None, None)
    assert status_json["releasable"] == decided["released"] and decided["releasable"] == [] and decided["statement"]
