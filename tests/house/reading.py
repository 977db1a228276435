"""What a reader meets in docs, reasons, help and docstrings: sentences, words nobody explained, borders of counts.

Only prose is judged: headings, code, tables and pictures are not, and a word in backticks is one word. Reasons are read
as a person meets them: with their longest phrases filled in. Full stop and semicolon end a sentence, and what stands in
brackets is one of its own: the numbers behind a plain statement. A word is known that stands in `basic_words.txt` or in
the glossary.
"""

import argparse
import ast
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

from softcal.app.cli.main import command_parser
from softcal.core.words.reason import ENGLISH, PLAIN

LONG = 25
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

PRIVATE = (
    "overlap", "mix of loads", "beside the forecast", "form the ratios", "ratios have", "leave open", "held-out",
    "whatever form", "mapped windows", "extrapolated", "`where`", "of the menu", "sitting", "brings the unit's use",
)  # fmt: skip
"""What strangers could not say the meaning of."""


@dataclass(frozen=True)
class Goal:
    """What the texts of one kind may not exceed.

    Args:
        long: share of the sentences with more than `LONG` words.
        unknown: words, each once, that are neither basic nor in the glossary.
    """

    long: float
    unknown: int


GOALS = {
    "docs": Goal(0.01, 1030),
    "reasons": Goal(0.0, 185),
    "help": Goal(0.0, 240),
    "docstrings": Goal(0.02, 2000),
}
"""A goal for each kind of text."""

MOST_WORDS = {"README.md": 600, "docs/operator.md": 800, "docs/long-term.md": 1200}
"""Words of pages that are read at one go, code and tables included."""
MOST_WORDS_OF_ALL = 45_000
"""Words of README and of the pages of docs/, decisions left out."""


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
        words, sentences: how many.
        long: the sentences of more than `LONG` words.
        unknown: words of neither list, once each.
    """

    words: int = 0
    sentences: int = 0
    long: tuple[str, ...] = ()
    unknown: frozenset[str] = frozenset()

    def __add__(self, other: "Spoken") -> "Spoken":
        return Spoken(
            self.words + other.words,
            self.sentences + other.sentences,
            self.long + other.long,
            self.unknown | other.unknown,
        )


def spoken(said: Mapping[str, str], code: str) -> str:
    """Return a reason with its longest phrases; numbers and names stay as a place, {}."""

    def phrase(place: re.Match[str]) -> str:
        codes = NESTED.get(place[1], ())
        is_phrase = not place[2] and code not in codes
        phrases = [spoken(said, one) for one in codes if one in said] if is_phrase else []
        return max(phrases, key=lambda text: len(text.split()), default="{}")

    return re.sub(r"\{(\w+)(:[^}]*)?\}", phrase, said[code])


def sentences_of(text: str) -> list[str]:
    """Return the sentences of a reason: what stands in brackets is one of its own, and a quoted command one word."""
    text = re.sub(r"`[^`]*`|(?<!\w)'[^']*'", "code", text)
    parts = [text]
    while bracket := re.search(r"\(([^()]*)\)", parts[0]):
        parts[0] = parts[0].replace(bracket[0], "", 1)
        parts.append(bracket[1])
    return [one for part in parts for one in re.split(r"(?<=[.!?])\s+|;\s+", part) if _words(one)]


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W\d_][\w'’.-]*\w|[^\W\d_]", text)


def reader_of(kind: str) -> Spoken:
    """Read all texts of a kind of `GOALS`."""
    known = known_words()
    if kind == "reasons":
        found = [sentences_of(spoken(REASONS, code)) for code in REASONS]
    else:
        found = [[s for s in _sentences(paragraph) if _words(s)] for paragraph in _paragraphs_of(kind)]
    return sum((_spoken_of(sentences, known) for sentences in found), Spoken())


def _paragraphs_of(kind: str) -> Iterator[str]:
    for text in pages().values() if kind == "docs" else [code_texts()[kind]]:
        yield from _paragraphs(text)


def _spoken_of(found: list[str], known: frozenset[str]) -> Spoken:
    words = [_words(one) for one in found]
    long = tuple(one.strip() for one, of in zip(found, words, strict=True) if len(of) > LONG)
    unknown = frozenset(word for of in words for word in map(str.lower, of) if not _is_known(word, known))
    return Spoken(sum(map(len, words)), len(found), long, unknown)


def _is_known(word: str, known: frozenset[str]) -> bool:
    """Return whether a word is known, with its endings; a name with a dot or an underscore is a name."""
    if "." in word or "_" in word or word in known:
        return True
    if "-" in word:
        return all(_is_known(part, known) for part in word.split("-") if part)
    stems = [
        word.removesuffix(end) for end in ("'s", "s", "es", "d", "ed", "r", "er", "st", "est", "ly", "ing", "n", "en")
    ]
    stems += [stem[:-1] for stem in stems if len(stem) > 2 and stem[-1] == stem[-2]]
    stems += [f"{stem}e" for stem in stems] + [f"{stem[:-1]}y" for stem in stems if stem.endswith("i")]
    stems += [stem.removeprefix(start) for stem in [word, *stems] for start in ("un", "re")]
    return any(stem in known for stem in stems)


def known_words() -> frozenset[str]:
    """Return the basic words and those of the glossary."""
    basic = Path(__file__).with_name("basic_words.txt").read_text(encoding="utf-8")
    basic = " ".join(line for line in basic.splitlines() if not line.startswith("#"))
    return frozenset(map(str.lower, [*basic.split(), *(word for term in glossary_terms() for word in _words(term))]))


def glossary_terms() -> frozenset[str]:
    """Return the terms that the glossary explains."""
    entries = re.findall(r"^- \*\*([^*]+)\*\*", (ROOT / "docs/glossary.md").read_text(encoding="utf-8"), re.MULTILINE)
    return frozenset(term.lower().replace("held out", "held-out") for entry in entries for term in entry.split(", "))


def private(said: Mapping[str, str]) -> dict[str, str]:
    """Return the texts with words that nobody outside knows: name → the last of those words."""
    return {code: word for code, text in said.items() for word in PRIVATE if word in text.lower()}


def private_of(kind: str) -> dict[str, str]:
    """Return the sentences of a kind of `GOALS` with words that nobody outside knows, less those in the glossary."""
    if kind == "reasons":
        return private(REASONS)
    sentences = {s: s for paragraph in _paragraphs_of(kind) for s in _sentences(paragraph)}
    return {said: word for said, word in private(sentences).items() if word not in glossary_terms()}


VERBS = "belongs|does|ends|explains|goes|has|is|its|moves|needs|reads|signs|speaks|stands|this|times|was"
PLURAL = re.compile(rf"(?<![\w.,:=+-])1 (?:(?!and\b|for\b|of\b|on\b|within\b)[a-z-]+ )?(?!(?:{VERBS})\b)[a-z]{{2,}}s\b")
"""One of several: "1 units", "1 audited units". Verbs and joining words are none."""

BROKEN = re.compile(r"\b0 of (?:the )?0\b|[{}]|\bnan\b|\binf\b|\bNone\b")
"""What no sentence may show, whatever its counts."""

FROM_ONE = {"step"}
"""Counts that begin at one."""


def at_the_borders(said: Mapping[str, str], code: str) -> list[str]:
    """Return what a reason says wrongly where its counts are 0, 1 or 2.

    Names of two places or fewer take every pair of counts, those of more one count at once. A place that formats a
    number in another way than a count stays one of a name.
    """
    text = said[code]
    names = list(dict.fromkeys(re.findall(r"\{(\w+)(?::\.?0?[gf%]|:\.0[f%])?\}", text)))
    counts = list(product((0, 1, 2), repeat=len(names))) if len(names) <= 2 else [(n,) * len(names) for n in (0, 1, 2)]
    wrong = []
    for of in counts:
        filled = text
        for name, count in zip(names, of, strict=True):
            least = max(count, 1) if name in FROM_ONE else count
            filled = re.sub(rf"\{{{name}(:[^}}]*)?\}}", str(least), filled)
        filled = re.sub(r"\{\w+(:[^}]*)?\}", "1.5", filled)
        wrong += [found[0] for found in (BROKEN.search(filled), PLURAL.search(filled)) if found]
    return wrong


def pages() -> dict[str, str]:
    """Return the pages of the documents: name → text."""
    paths = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


@cache
def code_texts() -> dict[str, str]:
    """Return what the code says to people: `help` as its commands print it, and `docstrings`."""
    docstrings = []
    for path in sorted(p for folder in ("app", "core", "db", "station") for p in (ROOT / folder).rglob("*.py")):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        named = (node for node in nodes if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef))
        docstrings += [_as_items(doc) for node in named if (doc := ast.get_docstring(node))]
    helped = sorted({text for parser in parsers(command_parser()) for text in _helped(parser)})
    return {"help": "\n\n".join(helped), "docstrings": "\n\n".join(docstrings)}


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
    said = [
        parser.description,
        *(action.help for action in [*parser._actions, *(one for group in below for one in group)]),
    ]
    yield from (text for text in said if text and text != argparse.SUPPRESS)


def _as_items(docstring: str) -> str:
    """Return a docstring with each argument as an item of its own, without its name."""
    return re.sub(r"^    [\w, *]+: ", "- ", re.sub(r"^\w+:$", "", docstring, flags=re.MULTILINE), flags=re.MULTILINE)
