"""Every reason the numerics can give is said in the language of the screen, with its values."""

import ast
import inspect
from functools import partial
from string import Formatter
from types import ModuleType

import pytest

from softcal.app.texts.catalogue import LANGUAGES, catalogue, text
from softcal.app.texts.reasons import PREFIX, parted, said
from softcal.app.views.lot import reason_kind
from softcal.core.maps import affine, monotone, paired, phase, synchronous
from softcal.core.unit import findings, health, verdict
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit, decide, decide_audited, default_limit

KOREAN, ENGLISH = partial(text, "ko"), partial(text, "en")
MODULES = [findings, health, verdict, affine, monotone, paired, phase, synchronous]
ERRORS = ("limit maximum_rmse",)
"""An error of the caller, no reason of a unit."""

SHORTEST_SENTENCE = 30
"""Shorter pieces of text in those modules are values within a sentence, or names."""


def sentences(module: ModuleType) -> list[str]:
    """Return every sentence a module makes from values, with a number in the place of each."""
    tree = ast.parse(inspect.getsource(module))
    made = [node for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)]
    texts = ["".join(part.value if isinstance(part, ast.Constant) else "1.5" for part in node.values) for node in made]
    return [found for found in texts if len(found) > SHORTEST_SENTENCE and not found.startswith(ERRORS)]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_every_sentence_of_the_numerics_stands_in_the_catalogue(module: ModuleType) -> None:
    found = sentences(module)
    assert found
    assert [sentence for sentence in found if said(sentence, KOREAN) == sentence] == []


def test_a_reason_without_values_is_said_in_korean() -> None:
    wiring = (
        "wrong wiring: the output moves against the source's direction; exchange the two leads or check the divider"
    )
    assert said(wiring, KOREAN).startswith("배선 오류")


@pytest.mark.parametrize("error", [0.05, 0.11, 0.13, 0.4])
def test_the_statement_of_a_verdict_is_said_in_korean_with_its_values(error: float) -> None:
    forecast = ErrorForecast(error, error - 0.03, error + 0.03)
    for limit in (Limit("N", 0.12), default_limit("N", 0.04)):
        reason = decide(forecast, limit).reasons[0]
        korean = said(reason, KOREAN)
        assert f"{error:.3g} N" in korean and "0.12 N" in korean and "예측" in korean
        assert not any(word in korean for word in (" is ", "limit", "stated"))
        assert said(reason, ENGLISH) == reason


def test_an_audited_verdict_is_said_in_korean() -> None:
    korean = [said(reason, KOREAN) for reason in decide_audited(0.1, 0.2, 900, Limit("N", 0.12)).reasons]
    assert "보정하지 않는 것보다 나쁨" in korean[0] and "측정" in korean[1]


def test_the_cause_within_a_reason_is_said_too() -> None:
    reason = (
        "unfamiliar: 12% of the mapped windows lie outside what the source has shown; "
        "its fast movements are unlike the source's: other sensor type, readout or rate"
    )
    assert "빠른 움직임" in said(reason, KOREAN) and "12%" in said(reason, KOREAN)


def test_a_reason_nobody_foresaw_stays_as_it_is() -> None:
    assert said("the moon was full", KOREAN) == "the moon was full"


def test_reasons_joined_in_one_message_are_parted_at_their_ends() -> None:
    reasons = [
        "clipped range: presses end flat at 1.62 V, 8.1% of the samples; check gain and supply of the readout",
        "something else",
        "predicted RMSE 0.31 N (95 %: 0.2 to 0.4) is above the limit 0.12 N (stated for the lot)",
    ]
    assert parted("; ".join(reasons)) == reasons
    assert parted("") == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_kind_of_reason_has_a_name_without_numbers(language: str) -> None:
    for key, template in catalogue()[language].items():
        if key.startswith(PREFIX) and not key.startswith(f"{PREFIX}part."):
            names = [name for _, name, _, _ in Formatter().parse(template) if name]
            kind = reason_kind(template.format(**dict.fromkeys(names, "0.5 N")))
            assert kind and not any(letter.isdigit() for letter in kind), key
