"""What a reader meets in docs, reasons and help: long sentences, borders of counts.

Only prose is judged: headings, code, tables and pictures are not, and a word in backticks is one word. Reasons are read
as a person meets them: with their longest phrases filled in. Full stop and semicolon end a sentence, and what stands in
brackets is one of its own: the numbers behind a plain statement. No word is counted or forbidden.
"""

import argparse
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

from softcal.app.cli.main import command_parser
from softcal.core.messages.reason import ENGLISH, PLAIN

LONG = 30
"""Words of a sentence above which it counts as long."""

ROOT = Path(__file__).parents[2]
REASONS = {code: text for code, text in ENGLISH.items() if code != PLAIN}

NESTED = {
    "source": ("part.predicted", "part.measured"),
    "relation": ("part.within", "part.within_close", "part.above", "part.above_close"),
    "origin": ("part.stated", "part.automatic"),
    "audits": ("part.here", "part.of_lots"),
    "seen": ("part.audits_beyond", "gap.seen.maps"),
    "any_form": ("part.any_form", "part.any_form_mean"),
    "cure": ("part.check_cable",),
    "cause": ("part.fast", "part.loads"),
    "what": ("part.pressed", "part.loaded"),
    "level": ("part.level", "part.levels"),
    "small": ("part.small_lot",),
    "state": ("left.lifted_roughly", "left.not_lifted", "left.runs_on"),
    "remedy": ("gap.remedy.usual",),
    "reaches": ("gate.reaches",),
}
"""Values of a reason that are phrases, and which ones; where a place formats a number it is none."""

MAX_WORDS = {"README.md": 600, "docs/operator.md": 800, "docs/long-term.md": 1200}
"""Words of pages that are read at one go, code and tables included."""


def _paragraphs(text: str) -> Iterable[str]:
    """Yield paragraphs and items of lists, without what is no prose."""
    text = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    lines: list[str] = []
    for line in [*text.splitlines(), ""]:
        item = re.match(r"\s*(?:[-*]|\d+\.)\s+", line)
        # Four spaces are code, except where they go on with an item of a list.
        skipped = line.startswith(("|", "#", "![")) or (line.startswith("    ") and not lines)
        if (item or skipped or not line.strip()) and lines:
            yield " ".join(lines)
            lines = []
        if line.strip() and not skipped:
            lines.append(line[item.end() :] if item else line.strip())


def _sentences(paragraph: str) -> list[str]:
    """Return the sentences of a paragraph, a word in backticks as "code" and a link as its text."""
    text = re.sub(r"`[^`]*`", "code", paragraph)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("*", "")
    text = re.sub(r"\b(e\.g|i\.e|vs|eq|al|Fig)\.", r"\1", text)
    return re.split(r"(?<=[.!?])\s+", text)


@dataclass(frozen=True)
class Spoken:
    """What a reader of one reason, or of several, meets.

    Args:
        sentences: how many.
        long: the sentences of more than `LONG` words.
    """

    sentences: int = 0
    long: tuple[str, ...] = ()

    def __add__(self, other: "Spoken") -> "Spoken":
        return Spoken(self.sentences + other.sentences, self.long + other.long)


def spoken(texts: Mapping[str, str], code: str) -> str:
    """Return a reason with its longest phrases; numbers and names stay as a place, {}."""

    def phrase(match: re.Match[str]) -> str:
        codes = NESTED.get(match[1], ())
        is_phrase = not match[2] and code not in codes
        phrases = [spoken(texts, one) for one in codes if one in texts] if is_phrase else []
        return max(phrases, key=lambda text: len(text.split()), default="{}")

    return re.sub(r"\{(\w+)(:[^}]*)?\}", phrase, texts[code])


def sentences_of(text: str) -> list[str]:
    """Return the sentences of a reason: what stands in brackets is one of its own, and a quoted command one word."""
    text = re.sub(r"`[^`]*`|(?<!\w)'[^']*'", "code", text)
    parts = [text]
    while bracket := re.search(r"\(([^()]*)\)", parts[0]):
        parts[0] = parts[0].replace(bracket[0], "", 1)
        parts.append(bracket[1])
    return [one for part in parts for one in re.split(r"(?<=[.!?])\s+|;\s+", part) if _words_of(one)]


def _words_of(text: str) -> list[str]:
    return re.findall(r"[^\W\d_][\w'’.-]*\w|[^\W\d_]", text)


def reader_of(kind: str) -> Spoken:
    """Read all texts of a kind."""
    if kind == "reasons":
        sentences_by_code = [sentences_of(spoken(REASONS, code)) for code in REASONS]
    else:
        sentences_by_code = [[s for s in _sentences(paragraph) if _words_of(s)] for paragraph in _paragraphs_of(kind)]
    return sum((_spoken_of(sentences) for sentences in sentences_by_code), Spoken())


def _paragraphs_of(kind: str) -> Iterator[str]:
    for text in pages().values() if kind == "docs" else [help_text()]:
        yield from _paragraphs(text)


def _spoken_of(sentences: list[str]) -> Spoken:
    return Spoken(len(sentences), tuple(one.strip() for one in sentences if len(_words_of(one)) > LONG))


VERBS = "belongs|does|ends|explains|goes|has|is|its|moves|needs|reads|signs|speaks|stands|this|times|was"
PLURAL = re.compile(rf"(?<![\w.,:=+-])1 (?:(?!and\b|for\b|of\b|on\b|within\b)[a-z-]+ )?(?!(?:{VERBS})\b)[a-z]{{2,}}s\b")
"""One of several: "1 units", "1 audited units". Verbs and joining words are none."""

BROKEN = re.compile(r"\b0 of (?:the )?0\b|[{}]|\bnan\b|\binf\b|\bNone\b")
"""What no sentence may show, whatever its counts."""

FROM_ONE = {"step"}
"""Counts that begin at one."""


def at_the_borders(texts: Mapping[str, str], code: str) -> list[str]:
    """Return what a reason says wrongly where its counts are 0, 1 or 2.

    Names of two places or fewer take every pair of counts, those of more one count at once. A place that formats a
    number in another way than a count stays one of a name.
    """
    text = texts[code]
    names = list(dict.fromkeys(re.findall(r"\{(\w+)(?::\.?0?[gf%]|:\.0[f%])?\}", text)))
    counts = list(product((0, 1, 2), repeat=len(names))) if len(names) <= 2 else [(n,) * len(names) for n in (0, 1, 2)]
    wrong = []
    for of in counts:
        filled = text
        for name, count in zip(names, of, strict=True):
            minimum = max(count, 1) if name in FROM_ONE else count
            filled = re.sub(rf"\{{{name}(:[^}}]*)?\}}", str(minimum), filled)
        filled = re.sub(r"\{\w+(:[^}]*)?\}", "1.5", filled)
        wrong += [match[0] for match in (BROKEN.search(filled), PLURAL.search(filled)) if match]
    return wrong


def pages() -> dict[str, str]:
    """Return the pages of the documents: name → text."""
    paths = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


@cache
def help_text() -> str:
    """Return what the commands print about themselves."""
    return "\n\n".join(sorted({text for parser in parsers(command_parser()) for text in _helped(parser)}))


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield a parser and that of every command below it."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from parsers(below)


def _helped(parser: argparse.ArgumentParser) -> Iterable[str]:
    """Yield the description of a command and what it says of each option and of each command below it."""
    below = [a._choices_actions for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    texts = [
        parser.description,
        *(action.help for action in [*parser._actions, *(one for group in below for one in group)]),
    ]
    yield from (text for text in texts if text and text != argparse.SUPPRESS)
