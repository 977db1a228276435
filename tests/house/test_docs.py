"""What the documents promise stands in the code: variables, messages, commands' names, links."""

import re
from pathlib import Path

from tests import architecture, promises

ROOT = Path(__file__).parents[2]
SOURCES = [path for folder in ("app", "core", "db", "station") for path in (ROOT / folder).rglob("*") if path.is_file()]
CODE = "\n".join(p.read_text("utf-8") for p in SOURCES if p.suffix in {".py", ".toml"})
DOCS = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


def _table(text: str, heading: str) -> list[str]:
    part = text.split(f"## {heading}\n", 1)[1].split("\n## ")[0]
    return re.findall(r"^\| `([^`]+)`", part, re.MULTILINE)


def test_every_environment_variable_is_explained_and_exists():
    explained = set(_table((ROOT / "docs/faq.md").read_text("utf-8"), "Environment variables"))
    # Read by tests and benchmarks alone.
    used = set(re.findall(r'"(SOFTCAL_[A-Z_]+)"', CODE)) | {"SOFTCAL_DATA"}
    assert explained == used


def test_every_message_that_the_questions_explain_is_said_somewhere():
    messages = _table((ROOT / "docs/faq.md").read_text("utf-8"), "When something is refused")
    assert len(messages) >= 4
    said = re.sub(r'"\s*\n\s*f?"', "", CODE)
    for message in messages:
        for part in (part.strip(" ,;") for part in message.split("...")):
            assert part in said, f"{part!r} is said nowhere"


def test_the_table_of_promises_is_that_of_the_tests():
    assert promises.PAGE.read_text("utf-8") == promises.page(), "run `make proof`"


def test_the_picture_of_the_architecture_is_drawn_from_the_imports():
    assert architecture.PICTURE.read_text("utf-8") == architecture.picture(), "run `make proof`"


def test_every_link_leads_to_a_file():
    missing = [
        (page.name, link)
        for page in DOCS
        for link in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text("utf-8"))
        if "://" not in link and not (page.parent / link).exists()
    ]
    assert missing == []


SHOWN = [
    (page, *found)
    for page in DOCS
    for found in re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
]


def test_a_file_that_a_page_shows_is_the_file():
    other = [(page.name, path) for page, path, shown in SHOWN if (ROOT / path).read_text("utf-8") != shown]
    assert SHOWN and other == []
