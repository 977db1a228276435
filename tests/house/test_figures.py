"""Every figure of a page of results stands in what a benchmark printed, and that benchmark is named in its section."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PRINTED = {path.stem: path.read_text("utf-8") for path in (ROOT / "benchmarks/printed").glob("*.md")}

SETTINGS = {
    "decisions/0080-a-lot-is-released-by-sample": "99 90",
    "decisions/0100-what-the-line-adds": "100 5 3 4.3 2.1",
    "decisions/0143-a-trim-is-one-rule": "143",
    "firmware": "1234 1.234 90 50 20 1.5 1024 512 1.2 1.4 300 150 4 85,000 1,920 700 2,500 2012",
    "hazards": "0.9 0.12 0.4 0.3 0.25 1.2 1.6 0.6 0.7 100 162 0.5 1000 20",
    "own-simulator": "90 300 8 0.4 0.9 2",
    "compare": "",
    "gap": "0.9 0.95 1 0.4 25 2 8 10 5 90 40 0.25 0.5",
    "long-term": "0.08 0.3 1.5 1.8 10 60",
    "results": "0.29 0.41 0.27 0.39 1/33 001 030 061 135 1.03 1.13 2.6 1.10 95 800 799 1199 400,000 100 1,000",
    "station": "1.1 34461 1000 100 120 122 0.9 10 3.3 170 28 73 42 223 1.4 1.6 15 2 18.2 0.5 5 80 0.05 0.03 90 1",
    "trust": "12 10 90 99 22 5 3 1961 16269 3951 2859",
}
"""Page → its numbers that nobody measured: settings, limits, rows that were used, and what the paper states."""

UNITS = "%|mN|N|ns|µs|ms|min|s|h|mV|V|mm|µm|MB|kB|GB|bytes|B|times|σ|mbar|K|Hz|mm/s|units/s"
NUMBER = r"\d+(?:,\d{3})*(?:\.\d+)?"
FIGURE = re.compile(rf"(?<![\w.,])({NUMBER})(?![\w.]*\d)( ?(?:{UNITS})(?!\w))?")
PAIR = re.compile(rf"(?<![\w.,])({NUMBER})(?: of |/)({NUMBER})(?![\w.,]*\d)")
GOAL = re.compile(
    r"\b(?:goal|target)s?(?: is| of)?(?: (?:at most|above|≥|≤))? [\d.,]+(?: ?(?:%|s|ms|N|mN|mm))?"
    r"|seeds? (?:from )?\d[\d ,]*(?:(?:to|and) \d+)?"
)


def _prose(page: str) -> str:
    """Return a page without code, links and the tables that another test holds row by row."""
    text = re.sub(r"^ *```.*?^ *```", "", page, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"(<!-- printed: \w+ -->)\n(?:\|.*\n)+", r"\1\n", text)
    return re.sub(r"^    .*$", "", text, flags=re.MULTILINE)


def _visible_prose(section: str) -> str:
    text = re.sub(r"<!--.*?-->|`[^`]*`|\]\([^)]*\)", "", section)
    return GOAL.sub("", text)


def _sections(page: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each section of a page with what the benchmarks that it names printed, or the page where it names none."""
    of_page = _printed_names(page)
    for section in re.split(r"^(?=#{2,3} )", page, flags=re.MULTILINE):
        yield _visible_prose(section), [PRINTED[name] for name in _printed_names(section) or of_page]


def _printed_names(text: str) -> list[str]:
    """Return what is named: `benchmarks/registry.py list` printed registry_list, `benchmarks/gap.py --cases 5` gap."""
    printed_names = set(re.findall(r"printed: (\w+)|`softcal (demo)`", text))
    names = {name for pair in printed_names for name in pair}
    for file, word in re.findall(r"benchmarks/(\w+)\.py(?: (?:--)?(\w+))?", text):
        names.add(f"{file}_{word}" if f"{file}_{word}" in PRINTED else file)
    return sorted(names & PRINTED.keys())


def _numbers(text: str) -> set[str]:
    return {number.replace(",", "") for number in re.findall(rf"(?<![\w.]){NUMBER}", text)}


def _is_printed(number: str, unit: str, printed: list[str]) -> bool:
    """Whether a number was printed: as it stands, or with more digits where it has three itself or is a percentage."""
    digits = number.replace(",", "")
    numbers = {float(one) for text in printed for one in _numbers(text)}
    if unit.strip() == "%":
        numbers |= {100 * one for one in numbers}
    decimals = len(digits.partition(".")[2])
    is_rounded = unit.strip() == "%" or len(digits.replace(".", "").lstrip("0")) >= 3
    return float(digits) in numbers or (is_rounded and float(digits) in {round(one, decimals) for one in numbers})


def _stand_together(first: str, second: str, printed: list[str]) -> bool:
    return any(
        {first.replace(",", ""), second.replace(",", "")} <= _numbers(line) for t in printed for line in t.splitlines()
    )


def _unprinted(name: str, page: str) -> list[str]:
    """Return the figures of a page that nothing printed."""
    settings, unprinted = set(SETTINGS[name].split()), []
    for prose, printed in _sections(_prose(page)):
        pairs = list(PAIR.finditer(prose))
        unprinted += [p[0] for p in pairs if p[0] not in settings and not _stand_together(p[1], p[2], printed)]
        for figure in FIGURE.finditer(PAIR.sub("", prose)):
            number, unit = figure[1], figure[2] or ""
            is_figure = unit or "." in number or "," in number or len(number) >= 3
            if is_figure and number not in settings and not _is_printed(number, unit, printed):
                unprinted.append(figure[0])
    return unprinted


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_every_figure_of_a_page_was_printed_by_a_benchmark_it_names(name: str) -> None:
    assert _unprinted(name, (ROOT / f"docs/{name}.md").read_text("utf-8")) == []


@pytest.mark.parametrize("name", sorted(SETTINGS))
def test_every_setting_still_stands_on_its_page(name: str) -> None:
    page = _prose((ROOT / f"docs/{name}.md").read_text("utf-8"))
    assert [number for number in SETTINGS[name].split() if not re.search(rf"(?<![\w.]){re.escape(number)}", page)] == []


@pytest.mark.parametrize(("prose", "other"), [("1.746", "1.747"), ("8.3 %", "8.4 %"), ("13 of 13", "11 of 13")])
def test_a_figure_that_nobody_printed_is_found(prose: str, other: str) -> None:
    page = "## Any\n\n`python benchmarks/maps_egain.py`, `python benchmarks/trust.py`: {}.\n"
    assert _unprinted("results", page.format(prose)) == []
    assert _unprinted("results", page.format(other)) == [other]
