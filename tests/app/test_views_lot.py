"""What the lot page says of a process: rules in words, capability refused or given, reasons counted by kind."""

from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.palette import DARK, LIGHT
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import plainly
from softcal.app.views.common import percent
from softcal.app.views.lot import process_view
from softcal.core.quality.yields import UnitRun, yields
from softcal.core.words.reason import Reason, reason
from softcal.db.entries import RunEntry

START = datetime(2026, 5, 4, tzinfo=UTC)


def runs_of(values) -> list[RunEntry]:
    return [
        RunEntry(f"U{k:03d}", START + timedelta(minutes=k), "pass", (), float(value)) for k, value in enumerate(values)
    ]


def test_a_stable_process_has_a_capability() -> None:
    values = 0.08 + 0.004 * np.tile([-1.0, 0.4, 1.1, -0.6, 0.2, -0.9, 0.8], 6)
    process = process_view(runs_of(values), 0.12)
    assert process.capability is not None and process.refusal is None
    sigma = np.abs(np.diff(values)).mean() / 1.128
    assert process.capability.cpk == pytest.approx((0.12 - values.mean()) / (3 * sigma), rel=1e-6)


def test_an_unstable_process_has_none_and_names_the_rule_and_the_unit(rng) -> None:
    values = np.r_[0.08 + 0.002 * rng.normal(size=40), 0.2]
    process = process_view(runs_of(values), 0.12)
    assert process.capability is None and process.refusal is not None and process.refusal.code == "chart.unstable"
    beyond = next(broken for broken in process.broken if broken.rule == 1)
    assert (beyond.last, beyond.forbids) == ("U040", True)


def test_too_few_units_make_no_chart() -> None:
    process = process_view(runs_of([0.1] * 5), 0.12)
    assert process.chart is None and process.refusal is not None and process.refusal.code == "chart.few"


def statement(source: str, relation: str, rmse: float) -> Reason:
    numbers = {"rmse": rmse, "lower": 0.1, "upper": 0.5, "limit": 0.12, "unit": "N", "origin": Reason("part.stated")}
    return reason("statement", source=Reason(f"part.{source}"), relation=Reason(f"part.{relation}"), **numbers)


@pytest.mark.parametrize("language", ["en", "ko"])
def test_reasons_are_counted_by_what_they_say_and_not_by_their_numbers(language: str) -> None:
    """A forecast and a measurement are two kinds; the same one with another number is one; no label has a number."""
    said = {
        "U1": statement("predicted", "above", 0.417),
        "U2": statement("predicted", "above", 0.523),
        "U3": statement("measured", "above", 0.417),
        "U4": reason("saturated", level="1.6 V", share=0.165),
    }
    found = yields({serial: [UnitRun("fail", (why,))] for serial, why in said.items()})
    assert [count for _, count in found.reasons] == [2, 1, 1]
    labels = [plainly(why, partial(text, language)) for why, _ in found.reasons]
    assert len(set(labels)) == 3 and not any(letter.isdigit() for label in labels for letter in label)


@pytest.mark.parametrize("colours", [LIGHT, DARK])
def test_limit_lines_are_seen_on_either_ground(rng, colours) -> None:
    process = process_view(runs_of(0.08 + 0.002 * rng.normal(size=400)), 0.12)
    figure = charts_lot.control_chart_figure(process, "N", colours, lambda key, **_: key)
    assert {shape.line.color for shape in figure.layout.shapes} == {colours.text, colours.limit}
    assert len(figure.data[0].x) == charts_lot.SHOWN_VALUES


def test_only_all_is_a_hundred_per_cent() -> None:
    assert [percent(share) for share in (None, 0.0, 1e-5, 0.5, 0.99999, 1.0)] == [
        "–",
        "0 %",
        "< 0.1 %",
        "50.0 %",
        "> 99.9 %",
        "100 %",
    ]
