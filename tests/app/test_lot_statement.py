"""The one page on a lot, read back with a tool that is not ours."""

import shutil
import subprocess
from dataclasses import replace
from datetime import date
from functools import partial
from pathlib import Path

import pytest

from softcal.app.export.certificates.lot_statement import LotStatementFacts, StatementRow, lot_statement_pdf
from softcal.app.texts.catalogue import text as text_of
from softcal.app.texts.reasons import said
from softcal.core.words.reason import plain, reason

FACTS = LotStatementFacts(
    lot="lot-1",
    sensor_model="EG <3 mm>",
    source="S0",
    quantity="force",
    reference_unit="N",
    limit_rmse=0.5,
    limit_origin=reason("part.stated"),
    network_id="ab" * 32,
    method_id="cd" * 32,
    made_on=date(2026, 5, 1),
    software="softcal 1.0",
    statement=plain("with 10 audits: at most 1 in 10 of the 30 released units beyond 0.5 N, 90 % confidence"),
    risk=0.1,
    confidence=0.9,
    factor=1.73,
    any_form=reason("part.any_form", share=0.206, risk=0.091),
    audits=tuple(StatementRow(f"A{k}", "lot-1", 0.2, 0.2 + 0.01 * k, True) for k in range(10)),
    drawn=(10, 40),
    released=tuple(f"U{k:03d}" for k in range(30)),
    counts={"pass": 40, "conditional": 2, "fail": 0},
    identifier="lot-1-20260501",
)

say = partial(text_of, "en")


def _text(pdf: bytes, tmp_path: Path) -> tuple[str, int]:
    if shutil.which("pdftotext") is None:
        pytest.skip("pdftotext (poppler-utils) is not installed")
    file = tmp_path / "statement.pdf"
    file.write_bytes(pdf)
    text = subprocess.run(["pdftotext", "-layout", str(file), "-"], capture_output=True, check=True).stdout.decode()
    return " ".join(text.split()), text.count("\f")


def test_one_page_says_what_is_promised_on_what_evidence_at_what_risk(tmp_path: Path) -> None:
    text, pages = _text(lot_statement_pdf(FACTS), tmp_path)
    assert pages == 1
    drawn, promise = say("paper.drawn.is", drawn=10, population=40), say("paper.promise.is", risk=0.1, confidence=0.9)
    for one in (str(FACTS.statement), say("paper.given"), "EG <3 mm>", "0.5 N", drawn, promise, "1.73", "U029"):
        assert one in text, one


@pytest.mark.parametrize("language", ["en", "ko"])
def test_a_large_lot_still_fits_one_page_and_says_what_is_left_out(tmp_path: Path, language: str) -> None:
    audits = tuple(StatementRow(f"LONG-SERIAL-{k:04d}", f"lot-{k % 7}", 0.2, 0.3, True) for k in range(80))
    facts = replace(FACTS, audits=audits, released=tuple(f"LONG-SERIAL-{k:05d}" for k in range(2000)))
    text, pages = _text(lot_statement_pdf(facts, partial(text_of, language)), tmp_path)
    assert pages == 1 and text_of(language, "paper.more", count=66) in text and "1970" in text


@pytest.mark.parametrize("language", ["en", "ko"])
def test_without_a_promise_the_page_says_so_in_the_language_of_the_reader(tmp_path: Path, language: str) -> None:
    say, unqualified = partial(text_of, language), reason("release.unqualified", why=reason("part.no_lot"))
    facts = replace(FACTS, released=(), factor=None, any_form=None, audits=(), statement=unqualified)
    text, pages = _text(lot_statement_pdf(facts, say), tmp_path)
    assert pages == 1
    facts_said = (say("paper.title", lot="lot-1"), say("paper.not_given"), say("paper.none"), say("reason.part.stated"))
    for one in (*facts_said, said(unqualified, say).partition(":")[0]):
        assert one in text, one


def test_equal_facts_make_equal_bytes() -> None:
    assert lot_statement_pdf(FACTS) == lot_statement_pdf(replace(FACTS))
