"""The pictures of the documentation: the operator's screen, every page, the figures of method.md.

python benchmarks/screenshots.py [--only NAME ...] [--out build/screenshots] [--docs] [--language ko]

NAME is `line` for the operator's screen, `method` for the figures, or a page; screens come light and dark. `--docs`
puts those that the documentation shows into docs/images. Needs Chromium, Playwright and Pillow; takes a few minutes.
"""

import shutil
from pathlib import Path

from common import desk_pictures, line_pictures, method_pictures
from common.command import parser_of
from common.screens import chromium

DOCS_IMAGES = Path("docs/images")
LINE, METHOD = "line", "method"
OFFICE_PAGES = (*desk_pictures.PAGES, *desk_pictures.PAGES_OF_QUALITY, desk_pictures.SIGN_IN)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--only", choices=(LINE, METHOD, *OFFICE_PAGES), action="append", metavar="NAME", help="repeatable"
    )
    parser.add_argument("--out", type=Path, default=Path("build/screenshots"))
    parser.add_argument("--docs", action="store_true", help="replace the pictures that the documentation shows")
    parser.add_argument("--language", default="en", help="of the operator's screen")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = options.only or (LINE, METHOD, *OFFICE_PAGES)
    with chromium() as browser:
        if LINE in names:
            line_pictures.take_all(browser, options.out, options.language)
        if METHOD in names:
            method_pictures.take_all(browser, options.out)
        if set(names) & set(OFFICE_PAGES):
            desk_pictures.take_all(browser, options.out, names)
    if options.docs:
        for picture in DOCS_IMAGES.glob("*.png"):
            if (new_picture := options.out / picture.name).exists():
                shutil.copyfile(new_picture, picture)


if __name__ == "__main__":
    main()
