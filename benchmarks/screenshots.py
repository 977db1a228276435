"""The pictures of the documentation: every state of the operator's screen and every page, light and dark.

python benchmarks/screenshots.py [--only NAME ...] [--out docs/images] [--language ko]

NAME is `line` for the operator's screen, or a page. Needs Chromium, Playwright and Pillow; takes a few minutes.
"""

import argparse
from pathlib import Path

from common import desk_pictures, line_pictures
from common.screens import chromium

LINE = "line"
DESK = (*desk_pictures.PAGES, *desk_pictures.PAGES_OF_QUALITY, desk_pictures.SIGN_IN)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=(LINE, *DESK), action="append", metavar="NAME", help="repeatable")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--language", default="en", help="of the operator's screen")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = options.only or (LINE, *DESK)
    with chromium() as browser:
        if LINE in names:
            line_pictures.take_all(browser, options.out, options.language)
        if set(names) & set(DESK):
            desk_pictures.take_all(browser, options.out, names)


if __name__ == "__main__":
    main()
