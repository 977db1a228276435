"""What axe finds on every page, at three widths, light and dark.

npm pack axe-core && tar xzf axe-core-*.tgz
python benchmarks/accessibility.py --axe package/axe.min.js [--out FOLDER]

A desk with every kind of content is opened as engineer, as quality and signed out. `--out` keeps a picture of each page
in full length. Printed by page: rules of axe that are broken, over all widths and both themes, and how far the page is
wider than its window. Needs Chromium and Playwright.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlencode

from common.command import parser_of
from common.desk_pictures import (
    LOT,
    NAME,
    PAGES,
    PAGES_OF_QUALITY,
    PIN,
    QUALITY,
    QUALITY_PIN,
    fill,
    settle,
    sign_in,
    station_served,
)
from common.screens import THEMES, chromium, served
from common.tables import print_table
from playwright.sync_api import Browser, Page, ViewportSize

from softcal.db.connection import open_registry

HEIGHTS = {820: 1180, 1280: 800, 1920: 1080}
"""Of a window by its width, in pixels."""

People = tuple[tuple[str, str, dict[str, str]], ...]
TALLEST_PX = 6000
RUN = "axe.run(document).then((found) => found.violations.map((one) => `${one.id} (${one.nodes.length})`))"
WIDER = "document.documentElement.scrollWidth - innerWidth"
UNIT = f"unit?unit={LOT}/U006"
MORE = {
    "line": "line",
    "new-lot": "lots?tab=files",
    "known-loads": f"lot?lot={LOT}&tab=known_loads",
    "lot-compare": f"lot?lot={LOT}&tab=compare",
    "unit-forecast": UNIT,
    **{f"unit-{tab}": f"{UNIT}&tab={tab}" for tab in ("recording", "files", "history", "compare")},
    "laboratory": "settings?tab=laboratory",
}


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--axe", type=Path, required=True, help="axe.min.js of the package axe-core")
    parser.add_argument("--widths", type=int, nargs="+", choices=HEIGHTS, default=list(HEIGHTS))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="softcal-bench-") as root:
        os.environ["XDG_DATA_HOME"] = root
        url = os.environ["SOFTCAL_REGISTRY"] = f"sqlite:///{Path(root) / 'registry.db'}"
        fill(url, Path(root))
        people = (
            (NAME, PIN, PAGES | MORE | diagnosis(url)),
            (QUALITY, QUALITY_PIN, PAGES_OF_QUALITY),
            ("", "", {"sign-in": "settings"}),
        )
        with served(url) as (address, _), station_served(url), chromium() as browser:
            violations: dict[str, tuple[set[str], list[int]]] = {}
            settings = options.axe.read_text(), options.widths, options.out
            for name, broken, wider in looks(browser, address, people, *settings):
                rules, widths = violations.setdefault(name, (set(), []))
                rules.update(broken)
                widths.append(wider)
    head = "page | looks | rules broken | px wider than the window"
    print_table(head, ((n, len(w), ", ".join(sorted(r)) or "none", max(w)) for n, (r, w) in violations.items()))


def diagnosis(url: str) -> dict[str, str]:
    """Return the address of the diagnosis that the desk was filled with."""
    with open_registry(url) as registry:
        (job,) = registry.job_board.jobs("diagnose")
    return {"gap-diagnosis": f"gap?{urlencode({'case': job.request['case'], 'job': job.job_id})}"}


def looks(
    browser: Browser, address: str, people: People, axe: str, widths: list[int], out: Path | None
) -> Iterator[tuple[str, list[str], int]]:
    """Give for every look at a page its name, the broken rules, and how far it is wider than its window."""
    for theme in THEMES:
        for width, height in ((width, HEIGHTS[width]) for width in widths):
            for name, pin, pages in people:
                size = ViewportSize(width=width, height=height)
                context = browser.new_context(viewport=size, color_scheme=theme, bypass_csp=True)
                page = context.new_page()
                if name:
                    sign_in(page, address, name, pin)
                for title, path in pages.items():
                    page.goto(f"{address}/{path}")
                    settle(page)
                    if out is not None:
                        save_page(page, out / f"{title}-{width}-{theme}.png", width, height)
                    page.evaluate(axe)
                    yield title, page.evaluate(RUN), page.evaluate(WIDER)
                context.close()


def save_page(page: Page, path: Path, width: int, height: int) -> None:
    """Take a picture of a page in full length."""
    path.parent.mkdir(parents=True, exist_ok=True)
    full = page.evaluate("Math.max(...[...document.querySelectorAll('[data-testid=stMain]')].map(e => e.scrollHeight))")
    page.set_viewport_size({"width": width, "height": min(TALLEST_PX, max(height, full))})
    page.wait_for_timeout(500)
    page.screenshot(path=path)
    page.set_viewport_size({"width": width, "height": height})


if __name__ == "__main__":
    main()
