"""Every reason the numerics can give is said in the language of the screen, with its values."""

import ast
import inspect
import json
from functools import partial
from itertools import product
from pathlib import Path
from string import Formatter

import pytest

from softcal.app.texts.catalogue import LANGUAGES, catalogue, text
from softcal.app.texts.reason_groups import reasons_by_verdict
from softcal.app.texts.reasons import PLAIN_PREFIX, PREFIX, render_plain_reason, render_reason
from softcal.core.maps import affine_map, ends, monotone, paired
from softcal.core.messages import reason as reasons
from softcal.core.messages import rig_sentences
from softcal.core.messages.reason import (
    ENGLISH,
    PLAIN,
    Reason,
    fill_sentence,
    pack_reasons,
    plain,
    reason,
    to_stored,
    unpack_reasons,
)
from softcal.core.quality.lot_status import UnitInLot
from softcal.core.unit import findings, health, verdict
from softcal.core.unit.correspondence import CorrespondenceConfig
from softcal.core.unit.evidence import DAY, LINE
from softcal.core.unit.measured_error import MeasuredError, Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.unit.uncertainty import ErrorForecast
from softcal.core.unit.verdict import Limit, compare_with_audit, compare_with_limit, default_limit
from softcal.station.messages import PAGES as DRIVER_PAGES

KOREAN, ENGLISH_WORDS = partial(text, "ko"), partial(text, "en")
MODULES = [findings, health, verdict, affine_map, ends, monotone, paired]


def example(code: str) -> Reason:
    """Return a reason of a code with a value for every place: a number where the sentence formats one."""
    if code == PLAIN:
        return plain("so")
    placeholders = [(name, spec) for _, name, spec, _ in Formatter().parse(ENGLISH[code]) if name]
    return Reason(code, {name: 0.5 if spec else "N" if name == "unit" else plain("so") for name, spec in placeholders})


SENTENCES = set(rig_sentences.SENTENCES).union(*DRIVER_PAGES.values())
VERDICTS = [code for code in ENGLISH if code not in SENTENCES]
EXAMPLES = [example(code) for code in VERDICTS]


def test_every_reason_is_rendered_in_every_language_with_the_same_values() -> None:
    for one, language in product(EXAMPLES, LANGUAGES):
        sentence = catalogue()[language][f"{PREFIX}{one.code}"]
        placeholders = {name for _, name, _, _ in Formatter().parse(sentence) if name}
        assert placeholders == set(one.values) or one.code == PLAIN
        assert render_reason(one, partial(text, language)) == one.render({one.code: sentence} | {PLAIN: "{text}"})


def whole(one: Reason) -> list[Reason]:
    """Return a reason with every phrase that tells a forecast from a measurement and how near the limit is."""
    if one.code != "statement":
        return [one]
    sources, relations = ("predicted", "measured"), ("within", "within_close", "above_close", "above")
    pairs = [(Reason(f"part.{s}"), Reason(f"part.{r}")) for s in sources for r in relations]
    return [Reason(one.code, {**one.values, "source": s, "relation": r}) for s, r in pairs]


# `data.` is what a diagnosis finds in the recordings of a rig, `audit.` what a page refuses, `release.` what is said
# of a whole lot, `lot_fit.source.` of a source beside other sources, `inspect.` what a file holds, `gap.` what a
# diagnosis says of a place and of the next run, `unused.` and `lot.` what is said of the files of a lot: not at a line.
LOT = ("release.", "unused.", "lot.", "lot_fit.source.")
NOT_AT_THE_LINE = ("part.", "inspect.", "data.", "audit.", "gap.", *LOT, PLAIN)


def test_every_reason_is_reported_plainly_to_the_line_without_numbers() -> None:
    at_the_line = [one for e in EXAMPLES if not e.code.startswith(NOT_AT_THE_LINE) for one in whole(e)]
    for one, language in product(at_the_line, LANGUAGES):
        sentence = render_plain_reason(one, partial(text, language))
        assert sentence in [
            text_of_key for key, text_of_key in catalogue()[language].items() if key.startswith(PLAIN_PREFIX)
        ], one
        assert sentence.endswith(".") and not any(c.isdigit() or c in "{};`" for c in sentence), one
        assert language == "en" or sentence != render_plain_reason(one, ENGLISH_WORDS), one


def test_a_reason_kept_as_a_sentence_is_shown_as_it_is() -> None:
    assert render_plain_reason(plain("two maps"), KOREAN) == render_reason(plain("two maps"), KOREAN) == "two maps"


def test_the_numerics_give_codes_that_exist_and_no_prose() -> None:
    for module in MODULES:
        calls = [node for node in ast.walk(ast.parse(inspect.getsource(module))) if isinstance(node, ast.Call)]
        reason_calls = [
            c for c in calls if isinstance(c.func, ast.Name) and c.func.id in ("reason", "Reason") and c.args
        ]
        codes = [c.args[0].value for c in reason_calls if isinstance(c.args[0], ast.Constant)]
        assert codes and set(codes) <= set(ENGLISH), module
        refusals = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id in ("UnitRefused", "Finding")]
        assert not any(isinstance(c.args[0], ast.Constant | ast.JoinedStr) for c in refusals), module


def test_every_code_is_given_somewhere() -> None:
    core = Path(reasons.__file__).parents[1]
    files = [
        path
        for folder in (core, core.parent / "app", core.parent / "db")
        for path in folder.rglob("*.py")
        if path.name not in ("reason.py", "sentences.py", "gap_sentences.py")
    ]
    source = "\n".join(path.read_text() for path in files)
    # `compare_with_limit` puts these two together from the name of what it judges.
    extra_codes = {PLAIN, "part.predicted", "part.measured"}
    unused = [code for code in VERDICTS if f'"{code}"' not in source and code not in extra_codes]
    assert unused == []


def test_a_reason_survives_being_kept() -> None:
    for one in EXAMPLES:
        assert Reason.parse(json.loads(json.dumps(one.to_json()))) == one
        assert Reason.parse(json.loads(json.dumps(to_stored(one)))) == one
        assert unpack_reasons(pack_reasons([one, one])) == (one, one) or one.code == PLAIN


def test_the_sentence_an_older_version_kept_stays_as_it_is() -> None:
    old = Reason.parse("drift inside the recording: estimates at rest move by +0.2 N; warm up, record again")
    assert render_reason(old, KOREAN) == str(old) and str(old).startswith("drift inside")


def test_a_code_of_a_later_version_stays_readable() -> None:
    assert str(Reason.parse({"code": "haunted", "values": {"ghosts": 3}})) == "haunted ghosts 3"


@pytest.mark.parametrize("error", [0.05, 0.11, 0.13, 0.4])
def test_the_statement_of_a_verdict_is_rendered_in_korean_with_its_values(error: float) -> None:
    forecast = ErrorForecast(error, error - 0.03, error + 0.03)
    for limit in (Limit("N", 0.12), default_limit("N", 0.04, 3.0, DecisionConfig())):
        (one,) = compare_with_limit(forecast, limit).reasons
        korean = render_reason(one, KOREAN)
        assert f"{error:.3g}" in korean and "예측" in korean
        assert one.code == "no_limit" or "0.12" in korean
        assert not any(word in korean for word in (" is ", "limit", "stated"))
        assert render_reason(one, ENGLISH_WORDS) == str(one)


def test_an_audited_verdict_is_rendered_in_korean() -> None:
    harmful = Scores(MeasuredError(0.1, 900), MeasuredError(0.2, 900))
    korean = [render_reason(one, KOREAN) for one in compare_with_audit(harmful, Limit("N", 0.12)).reasons]
    assert any("측정" in one for one in korean) and any("보정하지 않는 것보다 나쁨" in one for one in korean)


def test_the_cause_within_a_reason_is_reported_too() -> None:
    one = reason("unfamiliar", share=0.12, cause=Reason("part.fast"))
    assert "빠른 움직임" in render_reason(one, KOREAN) and "12%" in render_reason(one, KOREAN)


def test_a_message_that_was_kept_as_a_sentence_is_that_sentence() -> None:
    assert unpack_reasons("") == () and pack_reasons(()) == ""
    assert unpack_reasons("the moon was full; so was the glass") == (plain("the moon was full; so was the glass"),)


@pytest.mark.parametrize("language", ["en", "ko"])
def test_every_part_of_a_predicted_error_has_its_name_on_the_figure(language: str) -> None:
    kinds = [kind() for kind in CorrespondenceConfig.__subclasses__()]
    parts = {LINE, DAY} | {name for kind in kinds for name in (kind.base_term, *dict(kind.sensitivity))}
    assert len(parts) > 8
    for part in parts:
        assert text(language, f"part.{part}")


def test_a_verdict_within_a_reason_is_rendered_in_korean() -> None:
    why = reason("predicted_otherwise", verdict="fail", why=reason("dead.noise", spread=0.1, unit="V", cure="c"))
    assert "불합격" in render_reason(why, partial(text, "ko")) and "fail" not in render_reason(why, partial(text, "ko"))
    assert "predicted fail:" in render_reason(why, partial(text, "en"))


def test_reasons_of_many_units_are_joined_only_where_one_sentence_says_both() -> None:
    limit = Limit("N", 0.15)
    within, close = ErrorForecast(0.05, 0.04, 0.06), ErrorForecast(0.1499, 0.1, 0.2)
    units = [
        UnitInLot(f"U{k}", "conditional", compare_with_limit(error, limit).reasons)
        for k, error in enumerate((within, close, within, ErrorForecast(0.06, 0.05, 0.0701)))
    ]
    ((_, lines),) = reasons_by_verdict(units, ["conditional"])
    assert len(lines) == 2 and lines[0].startswith("U0, U2, U3: ")
    assert lines[1] == f"U1: {units[1].reasons[0]}"
    assert "0.050 to 0.060 N" in lines[0] and "0.040 to 0.070" in lines[0], "the decimals are those of one unit"


@pytest.mark.parametrize(("value", "spec", "expected"), [(-0.001, "+.0%", "+0%"), (-0.0001, ".2f", "0.00")])
def test_a_number_that_rounds_to_zero_has_no_sign_of_a_loss(value: float, spec: str, expected: str) -> None:
    assert fill_sentence(f"{{x:{spec}}}", {"x": value}) == expected
