"""Docs, reasons and help have short sentences; a reason is right for 0, 1 and 2."""

import re

import pytest

from softcal.app.texts.catalogue import LANGUAGES, catalogue
from softcal.app.texts.reasons import PREFIX
from softcal.core.messages.reason import ENGLISH
from softcal.core.quality.audit_plan import AuditConfig, evaluate_audit, plan_audit
from softcal.core.unit.verdict import Limit
from tests.house.reading import (
    BROKEN,
    MAX_WORDS,
    PLURAL,
    at_the_borders,
    pages,
    reader_of,
)

KINDS = ("docs", "reasons", "help")

FILES = re.compile(r"[\w/]*\w\.(toml|json|ini|ya?ml)\b")


@pytest.mark.parametrize("kind", KINDS)
def test_few_sentences_are_long(kind: str) -> None:
    read = reader_of(kind)
    assert len(read.long) <= 0.01 * read.sentences, sorted(read.long, key=len)[-15:]


def test_pages_that_are_read_at_one_go_are_short() -> None:
    word_counts = {name: len(text.split()) for name, text in pages().items()}
    assert {page: word_counts[page] for page, max_words in MAX_WORDS.items() if word_counts[page] > max_words} == {}


def test_every_reason_is_right_where_its_counts_are_none_one_or_two() -> None:
    wrong = {code: at_the_borders(ENGLISH, code) for code in ENGLISH}
    assert {code: problems for code, problems in wrong.items() if problems} == {}


def test_every_text_of_a_page_is_right_where_its_counts_are_none_one_or_two() -> None:
    # How far something is may begin at 0 of 0, and "None" is a word where no value stands.
    texts = {key: sentence for key, sentence in catalogue()["en"].items() if "{" in sentence}
    wrong = {key: at_the_borders(texts, key) for key in texts}
    wrong = {key: [one for one in problems if one != "0 of 0"] for key, problems in wrong.items()}
    assert {key: problems for key, problems in wrong.items() if problems} == {}


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_reason_names_a_file_to_edit(language: str) -> None:
    sentences = {
        key: sentence for key, sentence in catalogue()[language].items() if key.startswith((PREFIX, "plainly."))
    }
    assert {key: sentence for key, sentence in sentences.items() if FILES.search(sentence)} == {}


def test_who_is_to_change_the_station_file_is_the_engineer() -> None:
    # `station_file.` is said to whoever wrote that file.
    sentences = {code: sentence for code, sentence in ENGLISH.items() if "station file" in sentence}
    assert {
        code
        for code, sentence in sentences.items()
        if "engineer" not in sentence and not code.startswith("station_file.")
    } == set()


@pytest.mark.parametrize("units", [0, 1, 2, 3, 12])
@pytest.mark.parametrize("measured", [0.1, 9.0])
def test_what_an_audit_says_of_a_lot_is_right_for_every_number_of_units(units: int, measured: float) -> None:
    forecasts = {f"U{k}": 0.1 for k in range(units)}
    for doubtful, random_count in ((1, 0), (0, 1), (1, 1), (2, 10)):
        plan = plan_audit(forecasts, AuditConfig(doubtful=doubtful, random=random_count))
        sentence = evaluate_audit(plan, forecasts, dict.fromkeys(plan.serials, measured), Limit("N", 0.8)).text
        assert not BROKEN.search(sentence) and not PLURAL.search(sentence), sentence


@pytest.mark.parametrize(
    "sentence", ["at most 0 of the 0 units", "1 units", "with 1 audited units", "3 {unit}", "nan N", "times inf"]
)
def test_the_reader_sees_what_is_wrong_at_the_borders(sentence: str) -> None:
    assert BROKEN.search(sentence) or PLURAL.search(sentence)


@pytest.mark.parametrize(
    "sentence", ["units: 1", "1 of 2 loads was read", "unit 1 moves", "10 of the 30 units", "0.1 units"]
)
def test_the_reader_lets_pass_what_is_right(sentence: str) -> None:
    assert not BROKEN.search(sentence) and not PLURAL.search(sentence)
