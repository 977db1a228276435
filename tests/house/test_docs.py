"""What the documents promise stands in the code: variables, messages, links, figures as printed, and one rule once."""

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
    variables = set(re.findall(r'"(SOFTCAL_[A-Z_]+)"', CODE)) | {"SOFTCAL_DATA"}
    assert explained == variables


def test_every_message_that_the_questions_explain_exists():
    messages = _table((ROOT / "docs/faq.md").read_text("utf-8"), "When something is refused")
    assert len(messages) >= 4
    joined_code = re.sub(r'"\s*\n\s*f?"', "", CODE)
    for message in messages:
        for part in (part.strip(" ,;") for part in message.split("...")):
            assert part in joined_code, f"{part!r} is said nowhere"


def test_the_table_of_claims_is_that_of_the_tests():
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


def _anchors(page: Path) -> set[str]:
    """Return the places of a page that a link can lead to, as the site and code hosts name them."""
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_every_link_leads_to_a_heading_that_is_there():
    missing = [
        (page.name, link, anchor)
        for page in [*DOCS, ROOT / "CHANGELOG.md"]
        for link, anchor in re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text("utf-8"))
        if "://" not in link and anchor not in _anchors(page.parent / link if link else page)
    ]
    assert missing == []


INCLUDED_FILES = [
    (page, *parts)
    for page in DOCS
    for parts in re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
]


def test_a_file_that_a_page_shows_is_the_file():
    other = [(page.name, path) for page, path, block in INCLUDED_FILES if (ROOT / path).read_text("utf-8") != block]
    assert INCLUDED_FILES and other == []


RECORDS = sorted((ROOT / "docs/decisions").glob("*.md"))


def test_decisions_are_few_of_one_form_and_cited_by_what_they_govern():
    assert len(RECORDS) <= 20
    cited = "\n".join(page.read_text("utf-8") for page in DOCS if page not in RECORDS) + CODE
    for record in RECORDS:
        text = record.read_text("utf-8")
        assert re.match(rf"# {int(record.name[:4])}\. \S", text), record.name
        assert re.findall(r"^\*\*(\w+)\*\*", text, re.MULTILINE) == ["Status", "Context", "Decision", "Cost"], (
            record.name
        )
        assert f"decisions/{record.name}" in cited, record.name


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def _is_part_of(cells: list[str], row: list[str]) -> bool:
    """Whether cells stand in a row in this order; others may stand between them."""
    remaining = iter(row)
    return all(cell in remaining for cell in cells)


TABLES = [
    (page.name, name, table.splitlines())
    for page in DOCS
    for name, table in re.findall(r"<!-- printed: (\w+) -->\n((?:\|.*\n)+)", page.read_text("utf-8"))
]


def test_every_figure_of_a_table_is_one_that_a_benchmark_printed():
    assert len(TABLES) >= 15
    for page, name, table in TABLES:
        printed = (ROOT / "benchmarks/printed" / f"{name}.md").read_text("utf-8")
        rows = [_cells(line) for line in printed.splitlines() if line.startswith("|")]
        other = [
            line for line in table if "---" not in line and not any(_is_part_of(_cells(line), row) for row in rows)
        ]
        assert other == [], f"{page}: benchmarks/printed/{name}.md has no such row"


def test_what_a_benchmark_printed_names_a_benchmark_that_is_there():
    for path in (ROOT / "benchmarks/printed").glob("*.md"):
        commands = re.findall(
            r"^    (?:python (benchmarks/\w+\.py)|softcal (?:demo|paper))", path.read_text("utf-8"), re.MULTILINE
        )
        assert commands and all((ROOT / command).is_file() for command in commands if command), path.name


def test_the_rule_of_release_stands_once():
    pages = [
        page.name for page in DOCS if re.search(r"no unit passes on a forecast alone", page.read_text("utf-8"), re.I)
    ]
    bare = [
        name
        for name in pages
        if "trust.md#the-rule-of-release" not in next(p for p in DOCS if p.name == name).read_text("utf-8")
    ]
    assert bare == ["trust.md"], "the rule stands in trust.md; other pages link to it"
    stale = re.compile(
        r"audits? only (?:scores?|measures?)|which only (?:scores?|measures?)|rests on the forecast alone"
        r"|(?:audits?|load cell,|there|rows that|audit/, and `softcal batch LOT`) (?:to )?scores?\b|scores? the audits"
        r"|calibrated against one source|a lot has one source"
    )
    assert not [page.name for page in DOCS if stale.search(page.read_text("utf-8"))] and not stale.search(CODE)
