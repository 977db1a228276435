"""Units of one lot diagnosed together: shared causes, own sizes, outliers, and units that are left out."""

from dataclasses import asdict, dataclass

import numpy as np
import pytest
from common.lot_draw import draw_lot

from softcal.core import profiles
from softcal.core.errors import InputError
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import Yardstick
from softcal.core.gap.method import METHOD, GapMethod
from softcal.core.lot_diagnosis import UnitSearch, diagnose_lot, joint_logs, lot_logs
from softcal.core.transfer import CalibrationWorth
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=12, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.015)


def make_unit(serial, seed, *effects):
    rng = np.random.default_rng(seed)
    runs = []
    for k, profile in enumerate((profiles.ramps([3.1] * 5, 4.0), profiles.random_presses(rng, 20.0, 3.1))):
        t_s, stage_mm = profile.sample(50.0)
        twin = Twin(BASE, tuple(EffectSetting(e, v) for e, v in effects), READOUT)
        force_N, output_V = simulate(twin, t_s, stage_mm, rng)
        runs.append(Run(f"run {k}", t_s, READOUT, stage_mm, force_N, output_V, profile=profile.name))
    return Case(serial, tuple(runs))


@pytest.fixture(scope="module")
def mixed():
    """Three units with a lag, one with play instead, one whose recordings hold a mistake."""
    cases = {
        f"u{k}": make_unit(f"U{k}", k, ("readout_lag", {"tau": tau_s})) for k, tau_s in enumerate((0.06, 0.1, 0.14))
    }
    cases["other"] = make_unit("O", 7, ("backlash", {"b": 0.06}))
    bad = make_unit("B", 8)
    slow = [Run(r.name, 2.0 * r.t_s, READOUT, r.stage_mm, r.force_N, r.output_V) for r in bad.runs]
    cases["bad"] = Case("B", tuple(slow))
    lines = []
    return diagnose_lot(cases, lines.append), lines


def test_the_shared_cause_has_own_sizes(mixed):
    diagnosis, _ = mixed
    assert diagnosis.verdict == "explained" and diagnosis.causes == ("readout_lag",)
    assert diagnosis.probability["readout_lag"] > 0.99
    for member, tau_s in zip(diagnosis.members[:3], (0.06, 0.1, 0.14), strict=True):
        size = member.sizes["readout_lag"]["tau"]
        assert member.follows and abs(size.value - tau_s) < 0.1 * tau_s and size.low < size.value < size.high


def test_a_unit_with_another_cause_is_an_outlier_and_one_with_a_mistake_is_left_out(mixed):
    diagnosis, _ = mixed
    assert diagnosis.outliers == ["other"] and diagnosis.excluded == ["bad"]
    assert diagnosis.report()["outliers"] == ["other"]


def test_progress_names_every_unit(mixed):
    diagnosis, lines = mixed
    assert all(any(m.name in line for line in lines) for m in diagnosis.members)


@dataclass
class Counted:
    """As much of a problem as the price of a size asks for."""

    count: int = 1000
    method: GapMethod = METHOD


def of_logs(**logs):
    members = dict.fromkeys(map(_ids, logs))
    return UnitSearch(Counted(), None, {_ids(name): value for name, value in logs.items()}, members)


def _ids(name):
    return () if name == "none" else tuple(name.split("_and_"))


def test_what_no_unit_tells_apart_the_lot_does():
    unit = {"none": -60.0, "creep": -10.0, "relaxation": -12.0}
    logs, _ = lot_logs([of_logs(**unit) for _ in range(6)])
    assert logs[("creep",)] - logs[("relaxation",)] == pytest.approx(12.0, abs=0.1)


def test_the_prior_odds_of_a_cause_are_paid_once():
    prior = np.log(METHOD.evidence.prior_odds)
    units = [of_logs(none=-10.0, lag=-10.0 + prior + 3.0) for _ in range(4)]
    logs, _ = lot_logs(units)
    assert logs[("lag",)] - logs[()] == pytest.approx(4 * 3.0 + prior, abs=0.2)


def test_one_unit_cannot_outvote_the_lot_by_more_than_the_stated_factor():
    units = [of_logs(none=-100.0, lag=0.0) for _ in range(3)] + [of_logs(none=0.0, lag=-1e4)]
    logs, _ = lot_logs(units)
    assert logs[("lag",)] > logs.get((), -np.inf)
    assert units[3].log_term(("lag",)) >= np.log(METHOD.evidence.stray_odds) + units[3].top


def test_what_an_equation_leaves_in_every_unit_is_no_surer_for_being_repeated():
    def unit(chi2, other):
        misfits = {("creep",): (chi2, 60.0), ("relaxation",): (other, 60.0)}
        return UnitSearch(Counted(1000), Yardstick(900.0, 500.0), {}, {}, misfits)

    one, six = (joint_logs([unit(1400.0, 1900.0)] * count, [("creep",), ("relaxation",)]) for count in (1, 6))
    assert six[("creep",)] - six[("relaxation",)] == pytest.approx(one[("creep",)] - one[("relaxation",)], rel=0.05)


def test_within_the_noise_every_unit_counts_and_a_cheaper_cause_counts_once():
    def unit():
        misfits = {("creep",): (1000.0, 60.0), ("relaxation",): (1003.0, 64.0)}
        return UnitSearch(Counted(1000), Yardstick(1000.0, 0.0), {}, {}, misfits)

    logs = joint_logs([unit() for _ in range(5)], [("creep",), ("relaxation",)])
    assert logs[("creep",)] - logs[("relaxation",)] == pytest.approx(0.5 * (5 * 3.0 + 4.0), rel=0.05)


def test_a_lot_of_one_unit_is_reported():
    with pytest.raises(InputError):
        diagnose_lot({"u": make_unit("U", 1)})


def test_saved_recordings_are_net_of_those_the_twin_was_fitted_to():
    assert CalibrationWorth("u", 0.5, 0.21, (0.5, 0.3, 0.2, 0.1)).worth == 3
    assert CalibrationWorth("u", 0.5, 0.21, (0.5, 0.3, 0.2, 0.1)).saves == 2
    assert CalibrationWorth("u", 0.5, 0.9, (0.5, 0.3)).saves == 0
    none = CalibrationWorth("u", 0.5, 0.05, (0.5, 0.3, 0.2))
    assert none.worth is None and none.saves == 2


def test_a_drawn_lot_shares_its_cause_and_has_own_sizes():
    lot = draw_lot(11, "usual", 4)
    assert len({tuple(c.effect for c in unit.causes) for unit in lot}) == 1
    assert len({unit.rig.noise_V for unit in lot}) == 4 and len({unit.kept_back.seed for unit in lot}) == 4
    assert [asdict(u) for u in lot] == [asdict(u) for u in draw_lot(11, "usual", 4)]


def as_case(sealed):
    rig = sealed.rig
    readout = ReadoutMetadata(rig.vref_V, rig.adc_bits, rig.r_series_ohm, rig.sample_rate_Hz)
    runs = [sealed.measure(plan) for plan in sealed.plans]
    return Case(sealed.name, tuple(Run(f"run {k}", readout=readout, **r.columns) for k, r in enumerate(runs)))


@pytest.mark.long
def test_the_lot_parts_causes_that_one_unit_cannot():
    # Pressed at one speed only, the first unit's lag may as well be another cause.
    lot = draw_lot(7307, "one_speed", 4)
    diagnosis = diagnose_lot({sealed.name: as_case(sealed) for sealed in lot})
    assert diagnosis.members[0].diagnosis.verdict == "ambiguous"
    assert diagnosis.verdict == "explained" and diagnosis.causes == ("readout_lag",)
