"""How readable are the documents, before and after: words, words a sentence, long sentences, Flesch reading ease.

python benchmarks/readability.py BEFORE AFTER [--pages NAME ...]
python benchmarks/readability.py BEFORE AFTER --reasons        # the sentences of core/words instead of the pages
python benchmarks/readability.py BEFORE AFTER --code           # help texts and docstrings
python benchmarks/readability.py BEFORE AFTER --goals          # the goal of each kind, and what is found

BEFORE and AFTER are revisions of git, or folders that hold README.md and docs/. Only prose is judged: headings, code,
tables and pictures are not, and a word in backticks is one word of one syllable. Words in tables are counted beside it,
because prose can also be moved there.

Flesch reading ease (1948) is 206.835 - 1.015 words/sentence - 84.6 syllables/word: 60 to 70 is plain English, 30 to 50
difficult. Syllables are groups of vowels, without a silent e; a dictionary would need a download. Means over all pages
are over all of their words and sentences.

Reasons are read as a person meets them: with their longest phrases filled in. Full stop and semicolon end a sentence,
and what stands in brackets is one of its own: the numbers behind a plain statement. A word is known that stands in
`basic_words.txt` or in the glossary.
"""

import argparse
import ast
import io
import re
import subprocess
import tarfile
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

LONG = 25
"""Words of a sentence above which it counts as long."""

ROOT = Path(__file__).parents[1]
SPOKEN = tuple(f"core/words/{name}.py" for name in ("sentences", "gap_sentences", "rig_sentences"))
DRIVERS = "station/drivers/"
"""Where the sentences of all reasons stand: pages, and a TOML file beside each driver."""

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
"""A goal for each kind of text; `tests/house/test_plain.py` holds them."""

MOST_WORDS = {"README.md": 600, "docs/operator.md": 800, "docs/long-term.md": 1200}
"""Words of pages that are read at one go, code and tables included."""
MOST_WORDS_OF_ALL = 45_000
"""Words of README and of the pages of docs/, decisions left out."""


@dataclass(frozen=True)
class Prose:
    """Counts of one page, or of several."""

    words: int = 0
    in_tables: int = 0
    sentences: int = 0
    long: int = 0
    syllables: int = 0

    def __add__(self, other: "Prose") -> "Prose":
        return Prose(*(a + b for a, b in zip(vars(self).values(), vars(other).values(), strict=True)))

    @property
    def ease(self) -> float:
        return 206.835 - 1.015 * self.words / self.sentences - 84.6 * self.syllables / self.words

    def row(self) -> str:
        if not self.words:
            return f"– | {self.in_tables} | – | – | –"
        each, share = self.words / self.sentences, 100 * self.long / self.sentences
        return f"{self.words} | {self.in_tables} | {each:.1f} | {share:.0f} % | {self.ease:.0f}"


def prose(text: str) -> Prose:
    """Count the prose of a page of Markdown."""
    tables = " ".join(re.findall(r"^\|.*$", _without_blocks(text), re.MULTILINE))
    return sum(map(_paragraph, _paragraphs(text)), Prose(in_tables=len(re.findall(r"\b[A-Za-z]{2,}\b", tables))))


def _without_blocks(text: str) -> str:
    return re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)


def _paragraphs(text: str) -> Iterable[str]:
    """Yield paragraphs and items of lists, without what is no prose."""
    text = _without_blocks(text)
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


def _paragraph(text: str) -> Prose:
    found = [re.findall(r"[^\W\d_][\w'’-]*", part) for part in _sentences(text)]
    sentences = [words for words in found if words]
    syllables = sum(_syllables(word) for words in sentences for word in words)
    long = sum(len(words) > LONG for words in sentences)
    return Prose(sum(map(len, sentences)), 0, len(sentences), long, syllables)


def _syllables(word: str) -> int:
    if word == "code":
        return 1
    lower = re.sub(r"(?<=[^aeiouyl])e$|(?<=[^aeiouytd])ed$", "", word.lower())
    return max(1, len(re.findall(r"[aeiouy]+", lower)))


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

    def row(self) -> str:
        each = self.words / self.sentences
        return f"{self.sentences} | {self.words} | {each:.1f} | {len(self.long)} | {len(self.unknown)}"


def reasons(place: str) -> dict[str, str]:
    """Return the sentences of all reasons of a folder or of a revision: code → English."""
    said: dict[str, str] = {}
    if Path(place).is_dir():
        names = [path.relative_to(place).as_posix() for path in Path(place).glob("station/drivers/*.toml")]
    else:
        names = [name for name in _git("ls-tree", "--name-only", place, DRIVERS).split() if name.endswith(".toml")]
    for name in (*SPOKEN, *names):
        text = (
            (Path(place) / name).read_text(encoding="utf-8")
            if Path(place).is_dir()
            else _git("show", f"{place}:{name}")
        )
        if name.endswith(".toml"):
            said |= tomllib.loads(text)
            continue
        page = re.search(r'sentences\("""\n(.*?)\n"""\)', text, re.DOTALL)
        for line in page[1].replace("\n  ", " ").splitlines() if page else ():
            if line and not line.startswith("#"):
                code, said[code] = line.split(": ", 1)
    return said


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


def reader(said: Mapping[str, str], known: frozenset[str]) -> Spoken:
    """Read all reasons.

    Args:
        said: as `reasons` returns them.
        known: words that need no explanation.
    """
    return sum((_read(spoken(said, code), known) for code in said), Spoken())


def reader_of(kind: str, place: str = str(ROOT)) -> Spoken:
    """Read all texts of a kind of `GOALS`."""
    known = known_words()
    if kind == "reasons":
        return reader(reasons(place), known)
    texts = pages(place).values() if kind == "docs" else [code_texts(place)[kind]]
    paragraphs = (paragraph for text in texts for paragraph in _paragraphs(text))
    return sum((_spoken_of([s for s in _sentences(p) if _words(s)], known) for p in paragraphs), Spoken())


def _read(text: str, known: frozenset[str]) -> Spoken:
    return _spoken_of(sentences_of(text), known)


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
    basic = (ROOT / "benchmarks/basic_words.txt").read_text(encoding="utf-8")
    basic = " ".join(line for line in basic.splitlines() if not line.startswith("#"))
    return frozenset(map(str.lower, [*basic.split(), *(word for term in glossary_terms() for word in _words(term))]))


def glossary_terms() -> frozenset[str]:
    """Return the terms that the glossary explains."""
    entries = re.findall(r"^- \*\*([^*]+)\*\*", (ROOT / "docs/glossary.md").read_text(encoding="utf-8"), re.MULTILINE)
    return frozenset(term.lower().replace("held out", "held-out") for entry in entries for term in entry.split(", "))


def private(said: Mapping[str, str]) -> dict[str, str]:
    """Return the texts with words that nobody outside knows: name → the last of those words."""
    return {code: word for code, text in said.items() for word in PRIVATE if word in text.lower()}


def private_of(kind: str, place: str = str(ROOT)) -> dict[str, str]:
    """Return the sentences of a kind of `GOALS` with words that nobody outside knows, less those in the glossary."""
    if kind == "reasons":
        return private(reasons(place))
    texts = pages(place).values() if kind == "docs" else [code_texts(place)[kind]]
    sentences = {s: s for text in texts for paragraph in _paragraphs(text) for s in _sentences(paragraph)}
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


def pages(place: str) -> dict[str, str]:
    """Return the pages of a folder or of a revision: name → text."""
    if Path(place).is_dir():
        root = Path(place)
        found = [p for p in [root / "README.md", *sorted((root / "docs").rglob("*.md"))] if p.is_file()]
        return {str(p.relative_to(root)): p.read_text(encoding="utf-8") for p in found}
    names = _git("ls-tree", "-r", "--name-only", place, "README.md", "docs").split()
    return {name: _git("show", f"{place}:{name}") for name in names if name.endswith(".md")}


@cache
def code_texts(place: str) -> dict[str, str]:
    """Return what the code of a folder or of a revision says to people: `help` of commands, and `docstrings`.

    The help of this tree is what its commands print; of another one, what stands in its code as `help=`.
    """
    said = {"help": list[str](), "docstrings": list[str]()}
    for name, text in _modules(place):
        tree = ast.parse(text)
        nodes = [n for n in ast.walk(tree) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef)]
        said["docstrings"] += [_as_items(doc) for node in nodes if (doc := ast.get_docstring(node))]
        if name.startswith("app/cli/"):
            keywords = [k for k in ast.walk(tree) if isinstance(k, ast.keyword) and k.arg in ("help", "description")]
            said["help"] += [v for k in keywords if isinstance(k.value, ast.Constant) and (v := str(k.value.value))]
    if Path(place).resolve() == ROOT:
        said["help"] = sorted({text for parser in parsers() for text in _helped(parser)})
    return {kind: "\n\n".join(texts) for kind, texts in said.items()}


def parsers(parser: argparse.ArgumentParser | None = None) -> Iterable[argparse.ArgumentParser]:
    """Yield the parser of `softcal` and of every command below it."""
    from softcal.app.cli.main import command_parser

    parser = parser or command_parser()
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


def _modules(place: str) -> Iterable[tuple[str, str]]:
    folders = ("app", "core", "db", "station")
    if Path(place).is_dir():
        for path in sorted(p for folder in folders for p in (Path(place) / folder).rglob("*.py")):
            yield path.relative_to(place).as_posix(), path.read_text(encoding="utf-8")
        return
    packed = subprocess.run(["git", "archive", place, *folders], cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive.getmembers():
            if member.name.endswith(".py") and (file := archive.extractfile(member)):
                yield member.name, file.read().decode("utf-8")


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, check=False, capture_output=True, text=True, encoding="utf-8")
    if done.returncode:
        raise SystemExit(
            f"{done.stderr.strip()}; reasons are read from the first revision that keeps them as a page on"
        )
    return done.stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", help="revision or folder")
    parser.add_argument("after", help="revision or folder")
    parser.add_argument("--pages", nargs="+", metavar="NAME", help="these pages alone, such as docs/gap.md")
    parser.add_argument("--reasons", action="store_true", help="the sentences of all reasons, in place of the pages")
    parser.add_argument("--code", action="store_true", help="help texts and docstrings, in place of the pages")
    parser.add_argument("--goals", action="store_true", help="what is found of each kind of text beside its goal")
    arguments = parser.parse_args()
    if arguments.goals:
        _print_goals(arguments.before, arguments.after)
        return
    if arguments.reasons:
        _print_reasons(arguments.before, arguments.after)
        return
    read = code_texts if arguments.code else pages
    before, after = read(arguments.before), read(arguments.after)
    kept = arguments.pages or list(before | after)
    print("| page | when | words | in tables | words a sentence | longer than 25 words | Flesch |")
    print("|---|---|---|---|---|---|---|")
    for name in sorted(kept):
        for when, texts in (("before", before), ("after", after)):
            if name in texts and (when == "before" or texts[name] != before.get(name)):
                print(f"| {name} | {when} | {prose(texts[name]).row()} |")
    for when, texts in (("before", before), ("after", after)):
        print(f"| all | {when} | {sum((prose(texts[n]) for n in kept if n in texts), Prose()).row()} |")


def _print_goals(*places: str) -> None:
    print("| kind | when | sentences | longer than 25 | goal | unknown words | goal | private |")
    print("|---|---|---|---|---|---|---|---|")
    for kind, goal in GOALS.items():
        for when, place in zip(("before", "after"), places, strict=True):
            read = reader_of(kind, place)
            found = f"{len(read.long)} | {goal.long:.0%} | {len(read.unknown)} | {goal.unknown}"
            print(f"| {kind} | {when} | {read.sentences} | {found} | {len(private_of(kind, place))} |")


def _print_reasons(*places: str) -> None:
    known = known_words()
    print("| reasons | sentences | words | words a sentence | longer than 25 | unknown words | private | at 0, 1, 2 |")
    print("|---|---|---|---|---|---|---|---|")
    for when, place in zip(("before", "after"), places, strict=True):
        said = reasons(place)
        borders = sum(bool(at_the_borders(said, code)) for code in said)
        print(f"| {when} | {reader(said, known).row()} | {len(private(said))} | {borders} |")
    last = reader(said, known)
    print(*(f"long: {one}" for one in last.long), f"unknown: {', '.join(sorted(last.unknown))}", sep="\n")


if __name__ == "__main__":
    main()
