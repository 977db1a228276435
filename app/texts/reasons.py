"""What the numerics, the stations and the registry say, in the language of a screen.

A reason has its code and its values: it is said from the text `reason.CODE` of the language. A sentence that an older
version kept, or that was quoted from a file or a device, stays as it is.
"""

from collections.abc import Callable, Iterable
from contextlib import suppress
from datetime import datetime

from softcal.core.messages.reason import PLAIN, Reason, unpack_reasons

Translator = Callable[..., str]

PREFIX, PLAIN_PREFIX = "reason.", "plainly."
TEXT_PREFIXES = {
    "verdict": "within",
    "effect": "gap.effect",
    "channel": "gap.channel",
    "map": "gap.map",
    "profile": "gap.press",
    "unit": "gap.unit",
}
"""Values of a reason that are names of softcal's own → the phrases that say them."""

INSTANT_VALUE = "at"
"""The value of a reason that is an instant, kept as text (ISO 8601)."""

SEPARATOR = "; "


def render_reason(reason: Reason, translate: Translator) -> str:
    """Return one reason in words, those in its values too."""
    if reason.code == PLAIN:
        return str(reason)
    values: dict[str, object] = dict(reason.values)
    for name, value in reason.values.items():
        if isinstance(value, Reason):
            values[name] = render_reason(value, translate)
        elif isinstance(value, str) and name == INSTANT_VALUE:
            # A station that was not updated yet gives the hour alone.
            with suppress(ValueError):
                values[name] = datetime.fromisoformat(value)
        elif isinstance(value, str) and name in TEXT_PREFIXES:
            values[name] = translate_phrase(TEXT_PREFIXES[name], value, translate)
    return translate(f"{PREFIX}{reason.code}", **values)


def render_plain_reason(reason: Reason, translate: Translator) -> str:
    """Return a reason without numbers, for who stands at the line."""
    # A forecast and a measurement are told apart, and how near to the limit they are.
    parts = (reason.values.get("source"), reason.values.get("relation"))
    suffixes = [part.code.removeprefix("part") for part in parts if isinstance(part, Reason)]
    # Reasons of one family may be one to them.
    for code in (f"{reason.code}{''.join(suffixes)}", reason.code, reason.code.rpartition(".")[0]):
        with suppress(KeyError):
            return translate(f"{PLAIN_PREFIX}{code}")
    return render_reason(reason, translate)


def render_reasons(reasons: Iterable[Reason], translate: Translator) -> str:
    """Return several reasons as one line."""
    return SEPARATOR.join(render_reason(reason, translate) for reason in reasons)


def render_message(message: str, translate: Translator) -> str:
    """Return a message that was kept as text, of several reasons or a sentence, as one line."""
    return render_reasons(unpack_reasons(message), translate)


def translate_phrase(kind: str, text: str, translate: Translator) -> str:
    """Return a fixed phrase of the numerics, itself where a language has none."""
    try:
        return translate(f"{kind}.{text}")
    except KeyError:
        return text
