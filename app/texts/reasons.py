"""What the numerics and the station say, in the language of a screen.

The registry keeps the reason of a verdict, a condition of the gate and the message of a stop as the sentence they were
made as, in English, since a record must say the same for good. Each kind of sentence stands in the catalogue of texts
with its values in braces: `reason.CODE` of a verdict, `message.CODE` of the station, a clause between two semicolons
each; `reason.part.CODE` and `message.part.CODE` are phrases that are such values. Here a stored sentence is found by
the English one and said again with its values. What stands in no catalogue stays as it is.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache

from softcal.app.texts.catalogue import catalogue

Words = Callable[..., str]

PREFIX, MESSAGE = "reason.", "message."
BETWEEN = "; "
REMEMBERED = 2048


def said(reason: str, words: Words) -> str:
    """Return one reason, or a phrase within one, in the language of `words`."""
    found = _found(reason)
    if found is None:
        return reason
    key, values = found
    return words(key, **{name: said(value, words) for name, value in values.items()})


def all_said(reasons: Iterable[str], words: Words) -> str:
    """Return several reasons as one line."""
    return BETWEEN.join(said(reason, words) for reason in reasons)


def told(message: str, words: Words) -> str:
    """Return a message of several reasons or clauses as one line in the language of `words`."""
    return all_said(parted(message), words)


def parted(message: str) -> list[str]:
    """Return the reasons that were joined into one message; a reason may hold the mark between two itself."""
    rest, reasons = message.split(BETWEEN), []
    while rest:
        lengths = range(len(rest), 0, -1)
        length = next((n for n in lengths if _found(BETWEEN.join(rest[:n]))), 1)
        reasons.append(BETWEEN.join(rest[:length]))
        rest = rest[length:]
    return [reason for reason in reasons if reason]


@lru_cache(REMEMBERED)
def _found(reason: str) -> tuple[str, Mapping[str, str]] | None:
    """Return the key of the text a sentence was made from and its values; None where there is none."""
    for key, pattern in _patterns():
        if match := pattern.fullmatch(reason):
            return key, match.groupdict()
    return None


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    texts = [(key, text) for key, text in catalogue()["en"].items() if key.startswith((PREFIX, MESSAGE))]
    # A text that begins with a value fits the most: it is tried last.
    texts.sort(key=lambda entry: entry[1].startswith("{"))
    return tuple((key, re.compile(_expression(text))) for key, text in texts)


def _expression(text: str) -> str:
    # Braces survive `escape` as \{name\}; a value is anything that does not reach into the next reason.
    return re.sub(r"\\\{(\w+)\\\}", rf"(?P<\1>(?:(?!{BETWEEN}).)+?)", re.escape(text))
