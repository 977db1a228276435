"""What the numerics, the stations and the registry say, in the language of a screen.

A reason has its code and its values: it is said from the text `reason.CODE` of the language. A sentence that an older
version kept, or that was quoted from a file or a device, stays as it is.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import datetime

from softcal.core.messages.reason import PLAIN, Reason, unpacked

Words = Callable[..., str]

PREFIX, PLAINLY = "reason.", "plainly."
NAMES = {
    "verdict": "within",
    "effect": "gap.effect",
    "channel": "gap.channel",
    "map": "gap.map",
    "profile": "gap.press",
    "unit": "gap.unit",
}
"""Values of a reason that are names of softcal's own → the phrases that say them."""

INSTANT = "at"
"""The value of a reason that is an instant, kept as text (ISO 8601)."""

BETWEEN = "; "


def said(why: Reason, words: Words) -> str:
    """Return one reason in words, those in its values too."""
    if why.code == PLAIN:
        return str(why)
    values: dict[str, object] = dict(why.values)
    for name, value in why.values.items():
        if isinstance(value, Reason):
            values[name] = said(value, words)
        elif isinstance(value, str) and name == INSTANT:
            # A station that was not updated yet gives the hour alone.
            with suppress(ValueError):
                values[name] = datetime.fromisoformat(value)
        elif isinstance(value, str) and name in NAMES:
            values[name] = phrase(NAMES[name], value, words)
    return words(f"{PREFIX}{why.code}", **values)


def plainly(why: Reason, words: Words) -> str:
    """Return a reason without numbers, for who stands at the line."""
    # A forecast and a measurement are told apart, and how near to the limit they are.
    parts = (why.values.get("source"), why.values.get("relation"))
    ends = [part.code.removeprefix("part") for part in parts if isinstance(part, Reason)]
    # Reasons of one family may be one to them.
    for code in (f"{why.code}{''.join(ends)}", why.code, why.code.rpartition(".")[0]):
        with suppress(KeyError):
            return words(f"{PLAINLY}{code}")
    return said(why, words)


def all_said(reasons: Iterable[Reason], words: Words) -> str:
    """Return several reasons as one line."""
    return BETWEEN.join(said(why, words) for why in reasons)


def told(message: str, words: Words) -> str:
    """Return a message that was kept as text, of several reasons or a sentence, as one line."""
    return all_said(unpacked(message), words)


def phrase(kind: str, text: str, words: Words) -> str:
    """Return a fixed phrase of the numerics, itself where a language has none."""
    try:
        return words(f"{kind}.{text}")
    except KeyError:
        return text
