"""What the lot page says of a process: rules in words, capability refused or given, reasons counted by kind."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.app.charts import lot as charts_lot
from softcal.app.charts.compare import errors_of_lots
from softcal.app.charts.palette import DARK, LIGHT
from softcal.app.charts.style import log_ticks
from softcal.app.charts.unit import output_distributions
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_plain_reason
from softcal.app.views.common import percent
from softcal.app.views.lot import process_view
from softcal.core.messages.reason import Reason, reason
from softcal.core.quality.yields import UnitRun, yields
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
    logs = np.log10(values)
    sigma = np.abs(np.diff(logs)).mean() / 1.128
    assert process.capability.cpk == pytest.approx((np.log10(0.12) - logs.mean()) / (3 * sigma), rel=1e-6)


def test_an_unstable_process_has_none_and_names_the_rule_and_the_unit(rng) -> None:
    values = np.r_[0.08 + 0.002 * rng.normal(size=40), 0.2]
    process = process_view(runs_of(values), 0.12)
    assert process.capability is None and process.refusal is not None and process.refusal.code == "chart.unstable"
    # What refuses it is a rule that the chart shows.
    assert process.refusal.values["rule"] in [Reason(f"chart.rule.{one.rule}") for one in process.broken]
    beyond = next(broken for broken in process.broken if broken.rule == 1)
    assert (beyond.last, beyond.forbids) == ("U040", True)


def test_the_limits_are_errors_that_a_unit_can_have_and_one_that_failed_is_not_charted(rng) -> None:
    """Errors that lie near zero, and one unit that failed with hundred times as much."""
    good = runs_of(0.06 * np.exp(0.4 * rng.normal(size=60)))
    failed = replace(runs_of([9.0])[0], serial="bad", verdict="fail")
    process, alone = (process_view(runs, 0.12) for runs in ([*good[:30], failed, *good[30:]], good))
    lower, centre, upper = process.levels
    assert 0.0 < lower < centre < upper < 1.0 and process.levels == alone.levels
    assert "bad" not in process.serials and process.errors == pytest.approx([run.predicted_rmse for run in good])


def test_points_that_follow_one_another_break_a_rule_once() -> None:
    """Thirty units after a step: one side of the centre for two long runs is one break each, not one per point."""
    values = np.where(np.arange(60) < 30, 0.06, 0.07) * (1.0 + 0.01 * np.tile([-1.0, 1.0], 30))
    broken = {one.rule: one for one in process_view(runs_of(values), 0.12).broken}
    assert broken[2].count == 2 and broken[2].starts == (8, 38)


def test_too_few_units_make_no_chart() -> None:
    process = process_view(runs_of([0.1] * 5), 0.12)
    assert process.chart is None and process.refusal is not None and process.refusal.code == "chart.few"


def statement(source: str, relation: str, rmse: float) -> Reason:
    numbers = {"rmse": rmse, "lower": 0.1, "upper": 0.5, "limit": 0.12, "unit": "N", "origin": Reason("part.stated")}
    return reason("statement", source=Reason(f"part.{source}"), relation=Reason(f"part.{relation}"), **numbers)


@pytest.mark.parametrize("language", ["en", "ko"])
def test_reasons_are_counted_by_what_they_say_and_not_by_their_numbers(language: str) -> None:
    """A forecast and a measurement are two kinds; the same one with another number is one; no label has a number."""
    reasons = {
        "U1": statement("predicted", "above", 0.417),
        "U2": statement("predicted", "above", 0.523),
        "U3": statement("measured", "above", 0.417),
        "U4": reason("saturated", level="1.6 V", share=0.165),
    }
    lot_yields = yields({serial: [UnitRun("fail", (why,))] for serial, why in reasons.items()})
    assert [count for _, count in lot_yields.reasons] == [2, 1, 1]
    labels = [render_plain_reason(why, partial(text, language)) for why, _ in lot_yields.reasons]
    assert len(set(labels)) == 3 and not any(letter.isdigit() for label in labels for letter in label)


def control_chart(values, colours):
    view = SimpleNamespace(
        process=process_view(runs_of(values), 0.12), limit_rmse=0.12, lot=SimpleNamespace(reference_unit="N")
    )
    return charts_lot.control_chart_figure(view, colours, lambda key, **_: key)


@pytest.mark.parametrize("colours", [LIGHT, DARK])
def test_limit_lines_are_seen_on_either_ground(rng, colours) -> None:
    figure = control_chart(0.08 + 0.002 * rng.normal(size=400), colours)
    assert {shape.line.color for shape in figure.layout.shapes} == {colours.text, colours.limit}
    assert len(figure.data[0].x) == charts_lot.MAX_VALUES


def test_one_value_far_out_does_not_flatten_the_others_and_is_read_as_it_is(rng) -> None:
    values = 0.08 + 0.002 * rng.normal(size=40)
    values[20] = 8.0
    figure = control_chart(values, LIGHT)
    plotted, usual = np.array(figure.data[0].y), np.delete(values, 20)
    assert np.ptp(np.log(usual)) > 0.2 * np.ptp(np.log(plotted))
    assert figure.data[0].customdata[20] == "8.000 N"
    assert any("8.000 " in note.text for note in figure.layout.annotations)


@pytest.mark.parametrize(("low", "high"), [(0.05, 0.06), (0.0475, 0.0655), (0.02, 0.3), (0.001, 5.0)])
def test_an_axis_of_logarithms_has_marks_enough_to_read_it(low: float, high: float) -> None:
    ticks = [tick for tick in log_ticks(low, high) if low <= tick <= high]
    assert 3 <= len(ticks) <= 12 and ticks == sorted(set(ticks))


def errors_drawn(errors: dict[str, list[float]], limit: float | None):
    def predicted(verdict: str | None = None):
        return np.array(errors.get(verdict, []) if verdict else [value for some in errors.values() for value in some])

    view = SimpleNamespace(predicted=predicted, limit_rmse=limit, lot=SimpleNamespace(reference_unit="N"))
    return charts_lot.predicted_errors(view, LIGHT, lambda key, **_: key)


@pytest.mark.parametrize("limit", [None, 0.05, 0.3, 2.0])
@pytest.mark.parametrize(
    "errors",
    [
        {"pass": [0.0427, 0.0442, 0.0443, 0.0477]},
        {"pass": [0.1] * 40, "fail": [0.3, 9.0, 40.0]},
        {"pass": [0.07], "conditional": [0.07]},
        {},
    ],
)
def test_the_histogram_of_errors_is_whole(errors, limit) -> None:
    """Every unit stands in a bar, and every bar and the limit inside the axis, with room to its end."""
    figure = errors_drawn(errors, limit)
    low, high = figure.layout.xaxis.range
    assert sum(int(np.sum(bar.y)) for bar in figure.data) == sum(map(len, errors.values()))
    for bar in figure.data:
        assert low <= min(bar.x) and max(np.asarray(bar.x) + bar.width) < high
    for line in figure.layout.shapes:
        assert low < line.x0 < 0.95 * high


def test_the_boxes_of_lots_are_whole(rng) -> None:
    values = np.r_[rng.uniform(0.05, 0.06, 90), rng.uniform(0.8, 0.9, 10)]
    lot = SimpleNamespace(id="L", reference_unit="N")
    view = SimpleNamespace(predicted=lambda: values, limit_rmse=None, lot=lot)
    figure = errors_of_lots([view], LIGHT, lambda key, **_: key)
    assert figure.data[0].upperfence[0] < figure.layout.yaxis.range[1]


def test_the_distributions_of_outputs_are_whole(rng) -> None:
    spaces = [rng.normal(at, 0.1, 500) for at in (1.0, 1.2, 1.0)]
    view = SimpleNamespace(
        source=SimpleNamespace(unlabelled=SimpleNamespace(output=spaces[0])),
        recording=SimpleNamespace(output=spaces[1]),
        mapped=spaces[2],
        lot=SimpleNamespace(output_unit="V"),
    )
    every = np.concatenate(spaces)
    for series in output_distributions(view, LIGHT, lambda key, **_: key).data:
        assert (series.x[0], series.x[-1]) == (pytest.approx(every.min()), pytest.approx(every.max()))


def test_only_all_is_a_hundred_per_cent() -> None:
    assert [percent(share) for share in (None, 0.0, 1e-5, 0.5, 0.99999, 1.0)] == [
        "–",
        "0 %",
        "< 0.1 %",
        "50.0 %",
        "> 99.9 %",
        "100 %",
    ]
