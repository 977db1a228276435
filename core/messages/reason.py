"""What softcal says: a code with values. English stands in core, other languages in app/texts.

Sentences on units and verdicts stand in `sentences`, those of stations, their gates and the
registry in `rig_sentences`, those of a diagnosis in `gap_sentences`; drivers add their own.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, Union

from softcal.core.messages.figures import format_error, format_limit
from softcal.core.messages.gap_sentences import GAP_SENTENCES
from softcal.core.messages.rig_sentences import SENTENCES
from softcal.core.messages.sentences import UNIT_SENTENCES

Value = Union[str, float, int, "Reason"]

PLAIN = "plain"
"""Code of a sentence that is quoted, from a file or a device."""

ENGLISH: dict[str, str] = {PLAIN: "{text}", **UNIT_SENTENCES, **GAP_SENTENCES, **SENTENCES}
"""One sentence a code, values in braces; a value that is a reason is a phrase of its own."""

LIMITS = ("limit", "judged")
VALUES_IN_LIMIT_UNIT = ("rmse", "lower", "upper", "error", "day")
"""Values of a sentence in the unit of its `limit`: limits, and errors."""

_LOADERS: list[Callable[[], object]] = []


def add_messages(messages: Mapping[str, str]) -> None:
    """Add what a driver or another package says: code → English sentence, values in braces.

    Raises:
        ValueError: a code has another sentence already; none of them was added.
    """
    if conflicting := [code for code, sentence in messages.items() if ENGLISH.get(code, sentence) != sentence]:
        raise ValueError(f"{', '.join(conflicting)}: these codes have another message already; choose other codes")
    ENGLISH.update(messages)


def load_messages_by(load: Callable[[], object]) -> None:
    """Let the first code that is not known call `load`, which adds messages: who says little need not load them."""
    _LOADERS.append(load)


def has_message(code: str) -> bool:
    """Whether a code has a message, once those that are loaded late are there."""
    while code not in ENGLISH and _LOADERS:
        _LOADERS.pop()()
    return code in ENGLISH


@dataclass(frozen=True)
class Reason:
    """One thing that is said of a unit, a station or a file.

    Args:
        code: which sentence of `ENGLISH`.
        values: its numbers (with the physical unit beside them as `unit`), names and phrases.
    """

    code: str
    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not has_message(self.code):
            raise ValueError(f"reason {self.code!r} is none of {', '.join(ENGLISH)}")

    def __hash__(self) -> int:
        return hash((self.code, tuple(sorted(self.values.items(), key=lambda item: item[0]))))

    def __str__(self) -> str:
        return self.render(ENGLISH)

    def render(self, sentences: Mapping[str, str]) -> str:
        """Return the sentence by sentences of a language; what that lacks is said in English."""
        values = {name: v.render(sentences) if isinstance(v, Reason) else v for name, v in self.values.items()}
        return fill_sentence(sentences.get(self.code, ENGLISH[self.code]), values)

    def to_json(self) -> dict[str, object]:
        values = {name: v.to_json() if isinstance(v, Reason) else v for name, v in self.values.items()}
        return {"code": self.code, "values": values}

    @classmethod
    def parse(cls, stored: object) -> "Reason":
        """Read a reason that was kept: `to_json`, or a sentence that was quoted.

        A code that nobody here knows, of a package that is not installed, stays readable as its own name.
        """
        if isinstance(stored, Reason):
            return stored
        if not isinstance(stored, Mapping):
            return plain(str(stored))
        code, values = str(stored["code"]), stored["values"]
        if not has_message(code):
            return plain(" ".join([code, *(f"{name} {value}" for name, value in values.items())]))
        return cls(code, {name: cls.parse(v) if isinstance(v, Mapping) else v for name, v in values.items()})


class _Filler(Formatter):
    """Fills a sentence; a word in the place of a number ("nan") stands as it is."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, float):
            return format_number(value, format_spec)
        text: str = super().format_field(value, "" if isinstance(value, str) else format_spec)
        return text


def format_number(value: float, spec: str) -> str:
    """Return a number by a format; one that rounds to zero has no minus sign."""
    text = format(value, spec)
    return text if float(text.rstrip("%")) else text.replace("-", "+" if spec.startswith("+") else "")


def fill_sentence(sentence: str, values: Mapping[str, object]) -> str:
    """Return a sentence with its values filled in; a limit and errors beside it are written as everywhere."""
    numbers = {name: value for name, value in values.items() if isinstance(value, float)}
    texts = {name: format_limit(numbers[name]) for name in LIMITS if name in numbers}
    if "limit" in numbers:
        texts |= {
            name: format_error(numbers[name], numbers["limit"]) for name in VALUES_IN_LIMIT_UNIT if name in numbers
        }
    return _Filler().vformat(sentence, (), {**values, **texts})


def reason(code: str, /, **values: Value) -> Reason:
    """Return the reason of a code, its values as JSON can keep them.

    NumPy numbers become plain ones. A number that is none (nan, inf) becomes its word: whatever a
    device reported, the sentence about it is said.
    """
    return Reason(code, {name: _plain_value(value) for name, value in values.items()})


def plain(text: str) -> Reason:
    """Return a sentence as it stands, quoted from a file or a device."""
    return Reason(PLAIN, {"text": text})


def to_stored(given: Reason | str) -> object:
    """Return what a table keeps of a reason: its code and values, or its sentence."""
    parsed = Reason.parse(given)
    return str(parsed) if parsed.code == PLAIN else parsed.to_json()


def pack_reasons(reasons: Iterable[Reason | str]) -> str:
    """Return reasons as one text for a column that holds messages; `unpack_reasons` reads them back."""
    parsed = tuple(map(Reason.parse, reasons))
    if not any(one.code != PLAIN for one in parsed):
        return to_line(parsed)
    return json.dumps([one.to_json() for one in parsed], ensure_ascii=False)


def unpack_reasons(message: str) -> tuple[Reason, ...]:
    """Return the reasons that a message was packed from; another message is one sentence."""
    if not message.startswith('[{"code"'):
        return (plain(message),) if message else ()
    return tuple(map(Reason.parse, json.loads(message)))


def several(reasons: Sequence[Reason], code: str = "and") -> Reason:
    """Return reasons as one, by a sentence that holds a `first` one and the `rest`."""
    first, *rest = reasons
    return reason(code, first=first, rest=several(rest, code)) if rest else first


def root_of(cause: Reason) -> Reason:
    """Return what a run died of, without what became of its stage."""
    inner = cause.values.get("why") if cause.code == "rig.aborted" else None
    return root_of(inner) if isinstance(inner, Reason) else cause


def to_line(reasons: Iterable[Reason]) -> str:
    """Return several reasons as one English line."""
    return "; ".join(str(one) for one in reasons)


def with_sentences(values: Mapping[str, object], *names: str) -> dict[str, object]:
    """Return a record with its reasons of these names in English, and all of them as `reasons`."""
    reasons = {name: value for name in names if isinstance(value := values[name], Reason)}
    return {
        **values,
        **{name: str(one) for name, one in reasons.items()},
        "reasons": [one.to_json() for one in reasons.values()],
    }


def _plain_value(value: Value) -> Value:
    if isinstance(value, str | Reason):
        return value
    number = value.item() if hasattr(value, "item") else value
    return str(number) if isinstance(number, float) and not math.isfinite(number) else number
