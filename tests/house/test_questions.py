"""Each page answers three questions of its reader: the sentence that answers stands in it once."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
QUESTIONS = tomllib.loads((Path(__file__).parent / "questions.toml").read_text("utf-8"))
GENERATED = {"docs/api.md": "docstrings fill it when the site is built"}
PAGES = {"README.md", *(f"docs/{page.name}" for page in (ROOT / "docs").glob("*.md"))} - GENERATED.keys()


def _flat(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def test_every_page_is_asked_three_questions() -> None:
    assert {page: len(questions) for page, questions in QUESTIONS.items()} == dict.fromkeys(PAGES, 3)


@pytest.mark.parametrize("page", sorted(QUESTIONS))
def test_each_answer_stands_in_its_page_once(page: str) -> None:
    text = _flat((ROOT / page).read_text("utf-8"))
    assert {
        question: text.count(_flat(sentence))
        for question, sentence in QUESTIONS[page].items()
        if text.count(sentence) != 1
    } == {}
