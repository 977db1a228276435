"""What the line does to the load: stated, it is in forecast and interval; else it is said in N and in neither."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.maps.config import MapConfig
from softcal.core.quality.acceptance import tolerance_factor
from softcal.core.quality.release import AuditedUnit, release
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.explanation import contributions
from softcal.core.unit.line_spread import LineSpread, estimate_gains
from softcal.core.unit.method import LineConfig, Method, ReleaseConfig
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit


@pytest.fixture(scope="module")
def problem(source_model, press):
    model = replace(source_model, method=Method(map=MapConfig(family="affine")))
    return UnitProblem(model, press(2, gain=1.3, offset_V=0.05, seconds=120.0).unlabelled, Limit("N", 5.0))


@pytest.fixture(scope="module")
def plain(problem):
    return calibrate(problem)


@pytest.fixture(scope="module")
def with_stated_spread(problem):
    return calibrate(replace(problem, line=LineSpread(0.06, 0.08)))


def load_N(calibration):
    return calibration.fit.load_rms


def test_a_stated_spread_is_in_the_forecast_in_quadrature(plain, with_stated_spread, press):
    force_N = press(2, seconds=120.0).reference
    # The estimates' own load, after a map without labels: rest and gain are a little out.
    assert load_N(plain) == pytest.approx(np.sqrt(np.mean(force_N**2)), rel=0.15)
    assert with_stated_spread.forecast.rmse == pytest.approx(np.hypot(plain.forecast.rmse, 0.1 * load_N(plain)))
    assert contributions(with_stated_spread.fit)["line"] == pytest.approx(0.1 * load_N(plain))
    reason = with_stated_spread.decision.predicted.reasons[-1]
    assert reason.code == "line.stated" and reason.values["rmse"] == pytest.approx(0.1 * load_N(plain))


def test_a_stated_spread_widens_the_interval_with_the_load(plain, with_stated_spread):
    added = np.sqrt(with_stated_spread.interval.half_width**2 - plain.interval.half_width**2)
    level = plain.interval.low + (np.arange(added.shape[1]) + 0.5) * (plain.interval.high - plain.interval.low) / 64
    for row in added:
        # Beyond rest, a tenth of the load at the 90 % quantile of a normal distribution.
        np.testing.assert_allclose(row[8:], 1.645 * 0.1 * (level[8:] - level[0]), rtol=0.05, atol=0.02)


@pytest.mark.parametrize("line", [None, LineSpread(0.06)])
def test_a_spread_that_the_fit_of_the_lot_saw_is_in_forecast_interval_and_identity(problem, line):
    before, after = (replace(problem, line=line, press_spread=share) for share in (0.0, 0.08))
    plain, widened = calibrate(before), calibrate(after)
    added = 0.08 * load_N(plain)
    assert widened.forecast.rmse == pytest.approx(np.hypot(plain.forecast.rmse, added))
    assert np.all(widened.interval.half_width[:, 20:] > plain.interval.half_width[:, 20:])
    said = widened.decision.predicted.reasons
    assert [one.values["share"] for one in said if one.code == "lot_fit.spread"] == [0.08]
    assert before.fit_id != after.fit_id and widened.fit.map_sha256 == plain.fit.map_sha256


def test_a_spread_nobody_stated_is_reported_in_newton_and_changes_no_number(plain):
    default = LineConfig()
    reason = plain.decision.predicted.reasons[-1]
    assert reason.code == "line.open" and reason.values["unit"] == "N"
    assert reason.values["rmse"] == pytest.approx(np.hypot(default.load_spread, default.day_spread) * load_N(plain))
    assert reason.values["rmse"] > 0
    assert "line" not in plain.fit.budget and "line" not in contributions(plain.fit)


@pytest.mark.parametrize(
    ("with_stated_spread", "left_out"), [({"load": 0.06}, "day_spread"), ({"day": 0.08}, "load_spread")]
)
def test_of_two_spreads_the_one_that_nobody_stated_is_open_and_not_zero(problem, plain, with_stated_spread, left_out):
    one = calibrate(replace(problem, line=LineSpread(**with_stated_spread)))
    (share,), usual = with_stated_spread.values(), getattr(LineConfig(), left_out)
    assert one.forecast.rmse == pytest.approx(np.hypot(plain.forecast.rmse, share * load_N(plain)))
    stated_reason, unknown = one.decision.predicted.reasons[-2:]
    assert (stated_reason.code, stated_reason.values["share"]) == ("line.stated", share)
    assert (unknown.code, unknown.values["share"]) == ("line.open", pytest.approx(usual))
    assert unknown.values["rmse"] == pytest.approx(usual * load_N(plain))
    days, units = "from day to day", "from unit to unit"
    assert ((days, units) if "day" in with_stated_spread else (units, days)) == tuple(
        str(r.values["between"]) for r in (stated_reason, unknown)
    )


def test_a_stated_spread_is_no_finding_and_no_uncertainty_of_the_map(plain, with_stated_spread):
    assert with_stated_spread.fit.findings == plain.fit.findings


def test_what_was_stated_is_part_of_what_a_result_depends_on(problem):
    spreads = (None, LineSpread(0.02), LineSpread(0.02, 0.01))
    assert len({replace(problem, line=line).input_sha256 for line in spreads}) == 3


@pytest.mark.parametrize(("load", "day"), [(0.0, 0.0), (-0.1, 0.0), (3.0, 0.0), (0.03, float("nan"))])
def test_no_spread_and_percent_for_a_share_are_refused(load, day):
    with pytest.raises(InputError, match=r"\[line\]"):
        LineSpread(load, day)


def test_gains_of_audited_units_show_the_spread(rng):
    gains = estimate_gains(list(1.05 * np.exp(0.12 * rng.normal(size=4000))), 3)
    assert gains.centre == pytest.approx(1.05, rel=0.01) and gains.spread == pytest.approx(0.12, rel=0.05)
    assert estimate_gains([1.0, 1.1], 3) is None and estimate_gains([1.0, -0.4, 1.1], 3) is None


def test_what_golden_runs_show_from_day_to_day_is_kept_from_the_limit():
    audits = [AuditedUnit(f"A{k}", 0.3, 0.3 * (1 + 0.01 * k)) for k in range(10)]
    forecasts = {f"U{k}": 0.3 for k in range(4)}
    limit, config = Limit("N", 1.0), ReleaseConfig()
    factor = release(forecasts, audits, limit, config).factor
    remaining_share = np.sqrt(1.0 - (0.3 * factor) ** 2)
    within, beyond = (dict.fromkeys(forecasts, share * remaining_share) for share in (0.99, 1.01))
    assert len(release(forecasts, audits, limit, config, day_errors=within).released) == 4
    assert release(forecasts, audits, limit, config, day_errors=beyond).released == ()
    # Four days say less of the next than forty.
    assert tolerance_factor(4, 3, 0.1, 0.9) > 1.9 * tolerance_factor(40, 39, 0.1, 0.9)
