"""The error of an audit: scored on all rows with an estimate, its interval made with the number of these rows."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from softcal.core.maps.config import MapConfig
from softcal.core.network.config import NetworkConfig
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.estimate import estimate
from softcal.core.unit.measured_error import MeasuredError
from softcal.core.unit.method import DecisionConfig, Method
from softcal.core.unit.scoring import score_map
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit
from softcal.core.windows import TAPS


def test_an_audit_is_scored_on_every_row_that_has_an_estimate(source_model, press, linear_network) -> None:
    unit, audit = press(2, gain=1.3, seconds=120.0), press(3, gain=1.3)
    raw = audit.unlabelled
    late_s = raw.t_s + np.where(np.arange(len(raw)) >= 1000, 2.0, 0.0)
    gapped = LabelledRecording(replace(raw, t_s=late_s), audit.reference)
    model = replace(source_model, method=Method(map=MapConfig(family="affine")))
    calibration = calibrate(UnitProblem(model, unit.unlabelled, Limit("N", 2.0), audit=gapped))
    estimates = estimate(linear_network, calibration, gapped.unlabelled)
    has_estimate = np.isfinite(estimates.estimate)
    error = estimates.estimate[has_estimate] - gapped.reference[has_estimate]
    assert calibration.scores is not None
    assert calibration.scores.after.rmse == np.sqrt(np.mean(error**2))
    assert calibration.scores.after.rows == has_estimate.sum() == len(audit) - 2 * (TAPS - 1)
    flags = pd.Series(estimates.flag[~has_estimate]).value_counts().to_dict()
    assert calibration.scores.unscored == flags == {"warm-up": TAPS - 1, "gap": TAPS - 1}


def test_the_own_calibration_is_compared_on_its_test_rows_alone(source_model, press, linear_network) -> None:
    unit, audit = press(2, gain=1.3, seconds=120.0), press(3, gain=1.3)
    calibration = calibrate(UnitProblem(source_model, unit.unlabelled, Limit("N", 2.0)))
    config = NetworkConfig(hidden=(8,), max_epochs=20)
    scores = score_map(linear_network, calibration.unit_map, audit, DecisionConfig(), config)
    assert scores.own is not None and scores.own.own.rows < scores.after.rows
    rows = np.arange(len(audit) - scores.own.own.rows, len(audit))
    estimates = estimate(linear_network, calibration, audit.unlabelled).estimate
    assert scores.own.after == MeasuredError.from_estimates(estimates[rows], audit.reference[rows])
    again = score_map(linear_network, calibration.unit_map, audit, DecisionConfig(), scores.own.own)
    assert again == scores


def test_the_interval_covers_the_error_that_more_rows_would_show(rng) -> None:
    """Errors that are alike within a window: 95 % intervals hold the true error in at least 95 of 100 audits."""
    covered = 0
    for _ in range(400):
        white = rng.normal(size=1200 + 99)
        error = lfilter(np.ones(TAPS // 3) / np.sqrt(TAPS // 3), [1.0], white)[99:]
        interval = MeasuredError.from_estimates(error, np.zeros_like(error)).interval
        covered += interval.lower <= 1.0 <= interval.upper
    assert covered / 400 >= 0.95


def test_the_interval_of_a_measured_pair_holds_that_of_resampled_blocks(measured_data, rng) -> None:
    """Independent of any formula: blocks of a second of the paper's own audit, drawn anew (Künsch 1989)."""
    import softcal

    tables = []
    for name in ("S1", "S2"):
        table = pd.read_csv(measured_data / "egain_pair" / f"{name}.csv")
        columns = {"output": table.output_V, "reference": table.force_N}
        tables.append(pd.DataFrame({"t_s": np.arange(len(table)) / 50.0, **columns}))
    network = softcal.fit_network(tables[0], hidden=(32, 16))
    unit = softcal.fit_map(network, tables[1][["t_s", "output"]], limit_rmse=0.40, audit=tables[1])
    error = (unit.estimate(tables[1])["estimate"] - tables[1].reference).dropna().to_numpy()
    starts = rng.integers(0, len(error) - 50, (2000, len(error) // 50))
    resampled = error[(starts[..., None] + np.arange(50)).reshape(2000, -1)]
    low, high = np.quantile(np.sqrt(np.mean(resampled**2, axis=1)), [0.025, 0.975])
    scores = unit.state.scores
    assert scores is not None and scores.after.rows == len(error) == 1186
    assert scores.after.rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12) == unit.rmse(tables[1])
    interval = scores.after.interval
    assert interval.lower <= low <= high <= interval.upper
    assert interval.upper - interval.lower < 2.5 * (high - low)


def test_no_window_reaches_over_a_gap_in_the_score(source_model, press, linear_network) -> None:
    """Where half of the audit is shorter than a window, only the other half counts."""
    raw = press(3).unlabelled
    t_s = np.concatenate([raw.t_s[:10], raw.t_s[10:600] + 5.0])
    short = LabelledRecording(OutputRecording("U1", t_s, raw.output[:600], 50.0), press(3).reference[:600])
    unit = calibrate(UnitProblem(source_model, press(2, seconds=120.0).unlabelled, Limit("N", 2.0)))
    scores = score_map(linear_network, unit.unit_map, short, DecisionConfig())
    assert scores.after.rows == 590 - (TAPS - 1) and scores.unscored == {"warm-up": 10, "gap": TAPS - 1}
