"""The reasons of a verdict in the language of a screen.

The registry keeps a reason as the sentence the numerics made, in English, since a verdict must say the same for good.
Each kind of sentence stands in the catalogue of texts as `reason.CODE` with its values in braces (`reason.part.CODE`: a
phrase that is such a value); here a stored sentence is found by the English one and said again with its values. What
stands in no catalogue stays as it is.
"""

import re
from collections.abc import Callable, Iterable
from functools import cache

from softcal.app.texts import catalogue

Words = Callable[..., str]

PREFIX = "reason."
BETWEEN = "; "


def said(reason: str, words: Words) -> str:
    """Return one reason, or a phrase within one, in the language of `words`."""
    for code, pattern in _patterns():
        if match := pattern.fullmatch(reason):
            return words(PREFIX + code, **{name: said(value, words) for name, value in match.groupdict().items()})
    return reason


def all_said(reasons: Iterable[str], words: Words) -> str:
    """Return several reasons as one line."""
    return BETWEEN.join(said(reason, words) for reason in reasons)


def parted(message: str) -> list[str]:
    """Return the reasons that were joined into one message; a reason may hold the mark between two itself."""
    rest, reasons = message.split(BETWEEN), []
    while rest:
        lengths = range(len(rest), 0, -1)
        length = next((n for n in lengths if _is_known(BETWEEN.join(rest[:n]))), 1)
        reasons.append(BETWEEN.join(rest[:length]))
        rest = rest[length:]
    return [reason for reason in reasons if reason]


def _is_known(reason: str) -> bool:
    return any(pattern.fullmatch(reason) for _, pattern in _patterns())


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    texts = {key.removeprefix(PREFIX): text for key, text in catalogue()["en"].items() if key.startswith(PREFIX)}
    return tuple((code, re.compile(_expression(text))) for code, text in texts.items())


def _expression(text: str) -> str:
    # Braces survive `escape` as \{name\}; a value is anything that does not reach into the next reason.
    return re.sub(r"\\\{(\w+)\\\}", rf"(?P<\1>(?:(?!{BETWEEN}).)+?)", re.escape(text))
