"""Calibration by a line instead of a network: what twins and recordings of the rig are worth, by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softcal.core import transfer
from softcal.core.errors import InputError, UnitRefused
from softcal.core.gap.case import Case, Run
from softcal.core.gap.fit import fit
from softcal.core.gap.hypothesis import BASE, Hypothesis, to_fit
from softcal.core.gap.method import METHOD
from softcal.core.gap.model import Problem
from softcal.core.gap.twin import TWIN
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.transfer import CalibrationWorth, LotErrors, LotUnit, PressedLot, Transfer, calibration_worth
from softcal.core.twin.catalogue import EFFECTS
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(3.3, 20, 10.0, 50.0)
PAD = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.01, sigma_output_V=0.0005)
LATE = EffectSetting("wiring_resistance", {"Rw": 1.5})


class Line:
    """A line from the newest sample to the force, by least squares."""

    def __init__(self, source: LabelledRecording) -> None:
        self.slope, self.level = np.polyfit(source.windows[:, -1], source.window_reference, 1)

    def evaluate(self, windows):
        return self.level + self.slope * windows[:, -1]


@pytest.fixture
def lines(monkeypatch):
    trained = []

    def fit_network(source, config):
        trained.append(source)
        return SimpleNamespace(network=Line(source), validation_rows=np.arange(5))

    monkeypatch.setattr(transfer, "fit_network", fit_network)
    return trained


def run_of(number, twin, count=400):
    t_s = np.arange(count) * 0.02 + 3.0
    stage_mm = 1.5 * (1 - np.cos(2 * np.pi * (t_s - 3.0) / (2.5 + 0.4 * number)))
    force_N, output_V = simulate(twin, t_s, stage_mm, np.random.default_rng(number))
    return Run(str(number), t_s, READOUT, stage_mm, force_N, output_V)


RIG = Twin(PAD, (LATE,), READOUT)


def labelled(run):
    return LabelledRecording(OutputRecording("u", run.t_s, run.output_V, 50.0, stage_mm=run.stage_mm), run.force_N)


def rms(x):
    return float(np.sqrt(np.mean(np.square(x))))


def test_ratios_and_relative_errors_are_what_they_say():
    rig, base, explained = LotErrors(2.0, 0.5, 0.25), LotErrors(1.0, 0.4, 0.25), LotErrors(2.2, 0.6, 0.2)
    assert rig.after_by_own == 2.0
    comparison = Transfer(rig, base, explained, 3)
    rows = {name: values for name, *values in comparison.rows()}
    assert rows["before"] == [2.0, 1.0, 2.2, pytest.approx(0.5), pytest.approx(0.1)]
    assert rows["own"] == [0.25, 0.25, 0.2, 0.0, pytest.approx(0.2)]
    assert rows["after_by_own"] == pytest.approx([2.0, 1.6, 3.0, 0.2, 0.5])
    record = comparison.to_record()
    assert record["relative_error"]["after"] == {"base": pytest.approx(0.2), "explained": pytest.approx(0.2)}
    assert record["explained"]["after_by_own"] == pytest.approx(3.0) and record["units"] == 3


@pytest.mark.parametrize(
    ("rig", "explained", "worth", "saves"),
    [((0.9, 0.5, 0.3), 0.5, 2, 1), ((0.9, 0.5, 0.3), 0.1, None, 2), ((0.4, 0.5), 0.5, 1, 0), ((0.9,), 0.1, None, 0)],
)
def test_worth_is_the_fewest_recordings_that_do_as_well(rig, explained, worth, saves):
    one = CalibrationWorth("u", 2.0 * explained, explained, rig, fitted_on=1)
    assert (one.worth, one.saves) == (worth, saves)
    assert one.record()["worth"] == worth and one.record()["saves"] == saves
    nominal = next(
        (k for k, rig_error in enumerate(rig, start=1) if rig_error <= METHOD.worth.alike * 2.0 * explained), len(rig)
    )
    assert one.nominal_saves == max(nominal - 1, 0) == one.record()["nominal_saves"]


def test_as_well_is_within_the_ratio():
    alike = METHOD.worth.alike
    assert CalibrationWorth("u", 1.0, 1.0, (alike, 0.5)).worth == 1
    assert CalibrationWorth("u", 1.0, 1.0, (alike + 1e-9, 0.5)).worth == 2


def test_the_worth_of_a_cause_is_that_of_lines_trained_on_its_twins(lines):
    case = Case("u", tuple(run_of(k, RIG) for k in (1, 2, 3)))
    audit = Case("u", (run_of(8, RIG, 600),))
    at = np.array([to_fit(p, getattr(PAD, p.name)) for p in BASE])
    problem = Problem(TWIN, case, {"force_N": 0.01, "output_V": 0.0005})
    shared = fit(problem, Hypothesis((EFFECTS["wiring_resistance"],)), np.append(at, 1.2))
    messages = []
    worth = calibration_worth("u", case, audit, shared, messages.append)
    test = labelled(audit.runs[0])
    for k in (1, 2, 3):
        columns = [labelled(r) for r in case.runs[:k]]
        x, y = (
            np.concatenate([getattr(c, n)[..., -1] if n == "windows" else getattr(c, n) for c in columns])
            for n in ("windows", "window_reference")
        )
        line = np.polyfit(x, y, 1)
        assert worth.rig[k - 1] == pytest.approx(rms(np.polyval(line, test.windows[:, -1]) - test.window_reference))
    # Trained on a twin that is right, a line errs as one trained on the rig does.
    assert worth.explained == pytest.approx(worth.rig[-1], rel=0.05)
    assert worth.fitted_on == METHOD.worth.fitted_on and worth.unit == "u"
    nominal, explained = lines[0], lines[1]
    assert len(nominal) == len(explained) == 1200
    assert not np.array_equal(nominal.unlabelled.output, explained.unlabelled.output)
    with pytest.raises(InputError, match="stage_mm"):
        calibration_worth("u", Case("u", (replace(case.runs[0], stage_mm=None),)), audit, shared)


def lot(twin, count=2):
    source = labelled(run_of(0, twin, 500))
    return PressedLot(
        source,
        tuple(
            LotUnit(labelled(run_of(k, twin)).unlabelled, labelled(run_of(k + 5, twin, 500)))
            for k in range(1, count + 1)
        ),
    )


def test_errors_of_a_lot_are_medians_on_the_rest_of_each_audit(lines, monkeypatch):
    rig_lot = lot(RIG, 3)
    monkeypatch.setattr(transfer, "make_source_model", lambda source, network, rows, *, method: None)
    monkeypatch.setattr(transfer, "UnitProblem", lambda model, recording: recording)

    def calibrate(problem):
        if problem is rig_lot.units[1].recording:
            raise UnitRefused("no map")
        return SimpleNamespace(calibration="map")

    monkeypatch.setattr(transfer, "calibrate", calibrate)
    monkeypatch.setattr(
        transfer,
        "estimate",
        lambda network, calibration, recording: SimpleNamespace(estimate=np.full(len(recording), 1.5)),
    )
    lot_errors = transfer.lot_errors(rig_lot)
    shared, rows = Line(rig_lot.source), []
    for k, unit in enumerate(rig_lot.units):
        split = int(METHOD.worth.train_share * 500)
        test, train = unit.audit.part(split, 500), unit.audit.part(0, split)
        before = rms(shared.evaluate(test.windows) - test.window_reference)
        after = before if k == 1 else rms(1.5 - test.reference)
        rows.append((before, after, rms(Line(train).evaluate(test.windows) - test.window_reference)))
    assert (lot_errors.before, lot_errors.after, lot_errors.own) == pytest.approx(tuple(np.median(rows, axis=0)))


def test_a_lot_like_the_rigs_is_pressed_along_its_positions():
    rig = lot(RIG)
    like = transfer.simulate_alike(rig, Twin(PAD, (), READOUT), seed=3)
    assert len(like.units) == 2
    for mine, theirs in zip(
        (like.source, *(u.audit for u in like.units)), (rig.source, *(u.audit for u in rig.units)), strict=True
    ):
        np.testing.assert_array_equal(mine.unlabelled.stage_mm, theirs.unlabelled.stage_mm)
        np.testing.assert_array_equal(mine.unlabelled.t_s, theirs.unlabelled.t_s)
    again = transfer.simulate_alike(rig, Twin(PAD, (), READOUT), seed=3)
    np.testing.assert_array_equal(again.source.reference, like.source.reference)
    # Each is a unit of its own.
    assert not np.allclose(
        like.units[0].recording.output[:50].mean(), like.units[1].recording.output[:50].mean(), rtol=1e-6
    )
    with pytest.raises(ValueError, match="stage"):
        transfer.press_twin(RIG, replace(rig.source.unlabelled, stage_mm=None), np.random.default_rng(0))
    with pytest.raises(InputError, match="no unit"):
        PressedLot(rig.source, ())


def test_three_lots_are_compared(monkeypatch):
    rig = lot(RIG, 1)
    calls = []
    monkeypatch.setattr(transfer, "lot_errors", lambda made: calls.append(made) or LotErrors(len(calls), 1.0, 1.0))
    monkeypatch.setattr(transfer, "simulate_alike", lambda rig, twin, seed: (twin, seed))
    base, explained = Twin(PAD, (), READOUT), RIG
    comparison = transfer.transfer(rig, base, explained, seed=4)
    assert calls == [rig, (base, 4), (explained, 4)]
    assert (comparison.rig.before, comparison.base.before, comparison.explained.before, comparison.units) == (
        1,
        2,
        3,
        1,
    )
