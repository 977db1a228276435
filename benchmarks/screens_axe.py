"""What axe-core finds wrong on every page, in both languages and both themes.

python benchmarks/screens_axe.py [--languages en ko] [--themes light dark]

Every page is opened with something on it, as for the pictures of the desk, drawn to its end and searched with all rules
of axe-core (WCAG 2 A and AA and best practices). One row a finding: page, rule, how many nodes, the first of them. The
exit code is 1 where there is any. Needs Chromium, Playwright and `pip install axe-playwright-python`, which brings
axe-core.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

from playwright.sync_api import Browser, Page
from registry_common import print_markdown
from screens_common import THEMES, Theme, chromium, served
from screenshots_desk import LOT, NAME, PAGES, PAGES_OF_QUALITY, PIN, QUALITY, QUALITY_PIN, fill, settle, sign_in

MORE = {"line": "line", "start": "start", "new-lot": "new_lot", "known-loads": f"known_loads?lot={LOT}"}
SIGNED_OUT = {"sign-in": "sign_in"}
RUN = "async () => (await axe.run(document, {resultTypes: ['violations']})).violations"


def found(page: Page, script: str) -> list[tuple[str, int, str]]:
    """Return what axe finds on a page: rule, number of nodes, the first of them."""
    page.evaluate(script)
    return [(one["id"], len(one["nodes"]), one["nodes"][0]["html"][:90]) for one in page.evaluate(RUN)]


def rows(browser: Browser, address: str, language: str, theme: Theme) -> Iterator[tuple]:
    """Give the findings of every page in one language and theme."""
    script = (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")
    people = ((NAME, PIN, PAGES | MORE), (QUALITY, QUALITY_PIN, PAGES_OF_QUALITY), ("", "", SIGNED_OUT))
    for name, pin, pages in people:
        context = browser.new_context(viewport={"width": 1280, "height": 1000}, color_scheme=theme)
        page = context.new_page()
        if name:
            sign_in(page, address, name, pin)
        for shown, path in pages.items():
            page.goto(f"{address}/{path}{'&' if '?' in path else '?'}lang={language}")
            settle(page)
            for rule, count, first in found(page, script):
                yield shown, language, theme, rule, count, first.replace("|", "\\|").replace("\n", " ")
            print(shown, language, theme, file=sys.stderr, flush=True)
        context.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--languages", nargs="+", default=["en", "ko"])
    parser.add_argument("--themes", nargs="+", choices=THEMES, default=list(THEMES))
    parser.add_argument("--address", help="of an application that shows lot " + LOT + " already")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softcal-axe-", ignore_cleanup_errors=True) as root, chromium() as browser:
        if options.address:
            wrong = _all(browser, options.address, options)
        else:
            url = f"sqlite:///{Path(root) / 'registry.db'}"
            os.environ |= {"XDG_DATA_HOME": root, "SOFTCAL_REGISTRY": url}
            fill(url, Path(root))
            with served(url) as (address, _):
                wrong = _all(browser, address, options)
    print_markdown(("page", "language", "theme", "rule", "nodes", "first"), wrong)
    pages = len(PAGES) + len(PAGES_OF_QUALITY) + len(MORE) + len(SIGNED_OUT)
    looks = pages * len(options.languages) * len(options.themes)
    print(f"\n{pages} pages, {looks} looks: {len(wrong)} violations")
    sys.exit(bool(wrong))


def _all(browser: Browser, address: str, options: argparse.Namespace) -> list[tuple]:
    choices = ((language, theme) for language in options.languages for theme in options.themes)
    return [row for language, theme in choices for row in rows(browser, address, language, theme)]


if __name__ == "__main__":
    main()
