"""A unit costs what it needs: nothing of it, and nothing of its source, is computed twice."""

from dataclasses import replace

import numpy as np
import pytest

from softcal.core.maps import interface
from softcal.core.maps.catalogue import BUILTIN_FAMILIES
from softcal.core.maps.choose import dwell_distance
from softcal.core.maps.interface import FitProblem
from softcal.core.network.network import Network
from softcal.core.unit import evidence
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.method import Method
from softcal.core.unit.unit_problem import UnitProblem
from tests.layers import layered


@pytest.fixture
def unit(press):
    return press(2, gain=1.3, seconds=40.0).unlabelled


def test_rest_and_peak_are_matched_once_a_recording(source_model, unit, monkeypatch):
    calls, match = [], interface.match_ends
    monkeypatch.setattr(interface, "match_ends", lambda *given: calls.append(given) or match(*given))
    calibration = calibrate(UnitProblem(source_model, unit))
    assert calibration.unit_map.family == "averaged"
    # The recording, and it without each share.
    assert len(calls) == 1 + Method().forecast.parts


def test_f_reads_each_map_once(source_model, unit, monkeypatch):
    calibrate(UnitProblem(source_model, unit))
    rows, evaluate = [], Network.evaluate
    monkeypatch.setattr(Network, "evaluate", lambda self, w: rows.append(len(w)) or evaluate(self, w))
    calibrate(UnitProblem(source_model, unit))
    method = Method()
    # The map, three that might have been taken, one a share left out, and none at all.
    assert sum(rows) == (2 + 3 + method.forecast.parts) * len(unit.windows)


@pytest.mark.parametrize(
    "name", layered(sorted(BUILTIN_FAMILIES.keys() - {"synchronous", "stage_matched"}), ("affine", "monotone"))
)
def test_mapping_samples_is_mapping_windows_to_the_last_bit(source_model, unit, name):
    is_kept_row = np.ones(len(unit), dtype=bool)
    is_kept_row[600:650] = is_kept_row[900:905] = False
    gapped = replace(unit, t_s=unit.t_s[is_kept_row], output=unit.output[is_kept_row])
    rows = np.arange(len(gapped.windows))
    fitted = BUILTIN_FAMILIES[name].fit(FitProblem(source_model.source, source_model.network, gapped))
    mapped = evidence._mapped(fitted, gapped, rows)
    np.testing.assert_array_equal(mapped, fitted.apply(gapped.windows))
    np.testing.assert_array_equal(evidence._mapped(fitted, gapped, rows[::7]), fitted.apply(gapped.windows[::7]))


def test_a_known_source_spends_its_time_as_its_windows_say(source_model, press):
    source, other = source_model.source.unlabelled, press(5).windows
    edges = np.quantile(source.windows[:, -1], np.linspace(0, 1, 21)[1:-1])

    def shares(windows):
        level, rising = np.digitize(windows[:, -1], edges, right=True), windows[:, -5:].mean(1) > windows[:, :5].mean(1)
        return np.array([np.mean((level == k) & (rising == up)) for k in range(20) for up in (False, True)])

    expected = np.abs(shares(source.windows) - shares(other)).sum() / 2
    for _ in range(2):
        assert dwell_distance(source, other, 20) == pytest.approx(expected)
