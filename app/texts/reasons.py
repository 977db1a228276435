"""What the numerics and the station say, in the language of a screen.

A reason of a verdict has its code and its values: it is said from the text `reason.CODE` of the language. A condition
of the gate and the message of a stop are kept as the English sentence they were made as. Each kind of them stands in
the catalogue with its values in braces: `message.CODE`, a clause between two semicolons each; `message.part.CODE` are
phrases that are such values. A kept sentence is found by the English one and said again with its values. What stands in
no catalogue stays as it is, so does a reason that an older version kept as a sentence.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache

from softcal.app.texts.catalogue import catalogue
from softcal.core.reason import PLAIN, Reason, unpacked

Words = Callable[..., str]

PREFIX, PLAINLY, MESSAGE = "reason.", "plainly.", "message."
BETWEEN = "; "
REMEMBERED = 2048


def said(reason: str | Reason, words: Words) -> str:
    """Return one reason, or a phrase within one, in the language of `words`.

    A reason has its code and values; a message of the station is still found by its English sentence.
    """
    if isinstance(reason, Reason):
        if reason.code == PLAIN:
            return said(str(reason), words)
        told = {name: said(v, words) if isinstance(v, Reason) else v for name, v in reason.values.items()}
        return words(f"{PREFIX}{reason.code}", **told)
    found = _found(reason)
    if found is None:
        return reason
    key, values = found
    return words(key, **{name: said(value, words) for name, value in values.items()})


def plainly(reason: str | Reason, words: Words) -> str:
    """Return a reason for who stands at the line: what is wrong, without numbers; one kept as a sentence as it is."""
    if not isinstance(reason, Reason) or reason.code == PLAIN:
        return said(reason, words)
    # A forecast and a measurement are told apart, and how near to the limit they are.
    parts = (reason.values.get("source"), reason.values.get("relation"))
    ends = [part.code.removeprefix("part") for part in parts if isinstance(part, Reason)]
    try:
        return words(f"{PLAINLY}{reason.code}{''.join(ends)}")
    except KeyError:
        return said(reason, words)


def all_said(reasons: Iterable[str | Reason], words: Words) -> str:
    """Return several reasons as one line."""
    return BETWEEN.join(said(reason, words) for reason in reasons)


def told(message: str, words: Words) -> str:
    """Return a message of several reasons or clauses as one line in the language of `words`."""
    return all_said(parted(message), words)


def parted(message: str) -> list[str | Reason]:
    """Return the reasons that were joined into one message; a reason may hold the mark between two itself."""
    found = unpacked(message)
    if found and found[0].code != PLAIN:
        return list(found)
    rest = message.split(BETWEEN)
    reasons: list[str | Reason] = []
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
    texts = [(key, text) for key, text in catalogue()["en"].items() if key.startswith(MESSAGE)]
    # A text that begins with a value fits the most: it is tried last.
    texts.sort(key=lambda entry: entry[1].startswith("{"))
    return tuple((key, re.compile(_expression(text))) for key, text in texts)


def _expression(text: str) -> str:
    # Braces survive `escape` as \{name\}; a value is anything that does not reach into the next reason.
    return re.sub(r"\\\{(\w+)\\\}", rf"(?P<\1>(?:(?!{BETWEEN}).)+?)", re.escape(text))
