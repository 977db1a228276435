"""How readable are the documents, before and after: words, words a sentence, long sentences, Flesch reading ease.

python benchmarks/readability.py BEFORE AFTER [--pages NAME ...]

BEFORE and AFTER are revisions of git, or folders that hold README.md and docs/. Pages of docs/notebook/ are left out
unless they are named. Only prose is judged: headings, code, tables and pictures are not, and a word in backticks is
one word of one syllable. Words in tables are counted beside it, because prose can also be moved there.

Flesch reading ease (1948) is 206.835 - 1.015 words/sentence - 84.6 syllables/word: 60 to 70 is plain English, 30 to 50
difficult. Syllables are groups of vowels, without a silent e; a dictionary would need a download. Means over all pages
are over all of their words and sentences.
"""

import argparse
import re
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

LONG = 25
"""Words of a sentence above which it counts as long."""


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
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    tables = " ".join(re.findall(r"^\|.*$", text, re.MULTILINE))
    return sum(map(_paragraph, _paragraphs(text)), Prose(in_tables=len(re.findall(r"\b[A-Za-z]{2,}\b", tables))))


def _paragraphs(text: str) -> Iterable[str]:
    """Yield paragraphs and items of lists, without what is no prose."""
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


def _paragraph(text: str) -> Prose:
    text = re.sub(r"`[^`]*`", "code", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("*", "")
    text = re.sub(r"\b(e\.g|i\.e|vs|eq|al|Fig)\.", r"\1", text)
    found = [re.findall(r"[^\W\d_][\w'’-]*", part) for part in re.split(r"(?<=[.!?])\s+", text)]
    sentences = [words for words in found if words]
    syllables = sum(_syllables(word) for words in sentences for word in words)
    long = sum(len(words) > LONG for words in sentences)
    return Prose(sum(map(len, sentences)), 0, len(sentences), long, syllables)


def _syllables(word: str) -> int:
    if word == "code":
        return 1
    lower = re.sub(r"(?<=[^aeiouyl])e$|(?<=[^aeiouytd])ed$", "", word.lower())
    return max(1, len(re.findall(r"[aeiouy]+", lower)))


def pages(place: str) -> dict[str, str]:
    """Return the pages of a folder or of a revision: name → text."""
    if Path(place).is_dir():
        root = Path(place)
        found = [p for p in [root / "README.md", *sorted((root / "docs").rglob("*.md"))] if p.is_file()]
        return {str(p.relative_to(root)): p.read_text(encoding="utf-8") for p in found}
    names = _git("ls-tree", "-r", "--name-only", place, "README.md", "docs").split()
    return {name: _git("show", f"{place}:{name}") for name in names if name.endswith(".md")}


def _git(*words: str) -> str:
    root = Path(__file__).parents[1]
    return subprocess.run(
        ["git", *words], cwd=root, check=True, capture_output=True, text=True, encoding="utf-8"
    ).stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", help="revision or folder")
    parser.add_argument("after", help="revision or folder")
    parser.add_argument("--pages", nargs="+", metavar="NAME", help="these pages alone, such as docs/gap.md")
    arguments = parser.parse_args()
    before, after = pages(arguments.before), pages(arguments.after)
    kept = arguments.pages or [n for n in before | after if not n.startswith(("docs/notebook/", "docs/decisions/"))]
    print("| page | when | words | in tables | words a sentence | longer than 25 words | Flesch |")
    print("|---|---|---|---|---|---|---|")
    for name in sorted(kept):
        for when, texts in (("before", before), ("after", after)):
            if name in texts and (when == "before" or texts[name] != before.get(name)):
                print(f"| {name} | {when} | {prose(texts[name]).row()} |")
    for when, texts in (("before", before), ("after", after)):
        print(f"| all | {when} | {sum((prose(texts[n]) for n in kept if n in texts), Prose()).row()} |")


if __name__ == "__main__":
    main()
