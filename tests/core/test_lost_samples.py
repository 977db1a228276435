"""A few lost samples in an otherwise whole recording change neither map nor forecast by much, wherever they lie."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.maps.ends import match_ends
from softcal.core.maps.paired import paired_by_stage
from softcal.core.recording import LabelledRecording, Mask, OutputRecording
from softcal.core.unit.calibrate import fit_unit
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel
from softcal.core.unit.unit_problem import UnitProblem

METHOD = Method()


def without(recording: OutputRecording, is_lost: Mask) -> OutputRecording:
    stage = None if recording.stage_mm is None else recording.stage_mm[~is_lost]
    return replace(recording, t_s=recording.t_s[~is_lost], output=recording.output[~is_lost], stage_mm=stage)


def scattered(samples: int, count: int, seed: int) -> Mask:
    is_lost = np.zeros(samples, dtype=bool)
    is_lost[np.random.default_rng(seed).choice(samples - 60, count, replace=False) + 30] = True
    return is_lost


def unit(press, seconds: float) -> LabelledRecording:  # type: ignore[no-untyped-def]
    return press(2, gain=1.3, offset_V=0.05, seconds=seconds)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("seconds", "count"), ((24, 5), (24, 20), (60, 5), (60, 30)))
def test_forecast_of_a_unit_that_lost_a_few_samples(source_model: SourceModel, press, seconds, count, seed) -> None:  # type: ignore[no-untyped-def]
    whole = unit(press, seconds).unlabelled
    part = without(whole, scattered(len(whole), count, seed))
    usual, with_gaps = (fit_unit(UnitProblem(source_model, one))[0] for one in (whole, part))
    assert with_gaps.family == usual.family
    assert with_gaps.forecast.rmse == pytest.approx(usual.forecast.rmse, rel=0.05)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("length", (1, 5, 14))
def test_rest_and_peak_do_not_depend_on_how_many_pieces_lost_samples_leave(press, seed: int, length: int) -> None:  # type: ignore[no-untyped-def]
    source, whole = press(1, serial="S0", seconds=120.0), unit(press, 60).unlabelled
    starts = np.arange(40 + 31 * seed, len(whole) - 40, 149)
    is_lost = np.zeros(len(whole), dtype=bool)
    is_lost[(starts[:, None] + np.arange(length)).ravel()] = True
    usual, with_gaps = (match_ends(source, one, METHOD.map) for one in (whole, without(whole, is_lost)))
    assert with_gaps.gain == pytest.approx(usual.gain, rel=0.03)
    assert with_gaps.gain_error == pytest.approx(usual.gain_error, rel=0.3)


def test_pieces_far_from_each_other_are_not_joined(press) -> None:  # type: ignore[no-untyped-def]
    recording = unit(press, 60).unlabelled
    is_lost = np.zeros(len(recording), dtype=bool)
    is_lost[100:104] = is_lost[200:260] = True
    bridged = without(recording, is_lost).bridged
    assert len(bridged.segments) == 2 and len(bridged) == len(recording) - 60
    # A straight line from the last sample before to the first one after.
    assert bridged.output[99:105] == pytest.approx(np.linspace(recording.output[99], recording.output[104], 6))
    assert recording.bridged is recording


def test_stage_histories_go_on_across_a_lost_sample(press) -> None:  # type: ignore[no-untyped-def]
    def staged(labelled: LabelledRecording) -> OutputRecording:
        return replace(labelled.unlabelled, stage_mm=labelled.reference)

    source, whole = staged(press(1, serial="S0", seconds=120.0)), staged(unit(press, 60))
    part = without(whole, scattered(len(whole), 20, 0))
    pairs, target_rows = paired_by_stage(source, part, METHOD.map)
    usual, usual_rows = paired_by_stage(source, whole, METHOD.map)
    expected = dict(zip(whole.window_rows[usual_rows].tolist(), usual.tolist(), strict=True))
    at = np.searchsorted(whole.t_s, part.t_s[part.window_rows[target_rows]])
    is_same = [expected.get(int(row)) == match for row, match in zip(at, pairs.tolist(), strict=True)]
    assert np.mean(is_same) > 0.99
