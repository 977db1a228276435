"""Long use of measured sensors: the nylon strain runs, their first quarter calibrated with a reference."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.registry.unit import source_state
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.operation.adapter import Adapter
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.estimate import estimate


@pytest.mark.parametrize(("run", "ratio"), [("sin_20", 0.36), ("tri_30", 0.2), ("mixed_10_20", 0.85)])
def test_a_measured_sensor_in_steady_operation_is_followed_and_no_third_is_harmed(
    measured_data: Path, run: str, ratio: float
) -> None:
    """The first quarter of a run calibrates. sin_20 and mixed_10_20 chose the method; tri_30 did not."""
    t_s, output, strain = pd.read_parquet(measured_data / "nylon_drift" / f"{run}.parquet").to_numpy().T
    first, later = slice(0, len(t_s) // 4), slice(len(t_s) // 4, None)
    source = LabelledRecording(OutputRecording("unit", t_s[first], output[first], 10.0), strain[first])
    network = fit_network(source, NetworkConfig(seed=0)).network
    calibration = source_state(source, network)
    recording = OutputRecording("unit", t_s[later], output[later], 10.0)

    still = estimate(network, calibration, recording).estimate
    followed = Adapter(network, calibration, source.unlabelled).advance(recording.t_s, recording.output).estimate

    truth = strain[later]
    assert rmse(followed, truth) <= ratio * rmse(still, truth)
    for part in np.array_split(np.arange(len(truth)), 3):
        assert rmse(followed[part], truth[part]) <= 1.05 * rmse(still[part], truth[part])
