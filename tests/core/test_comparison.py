"""What a recording shows beside the source's: another unit of measure or sign is named, other sensors are not."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.core.inspection.comparison import compare_recordings
from softcal.core.recording import LabelledRecording, OutputRecording

UNIT_OF = {1 / 9.80665: "kgf", 1 / 4.44822: "lbf", 1e3: "mN", 1e-3: "kN"}


def labelled(output: np.ndarray, force_N: np.ndarray, unit: str = "N", serial: str = "U") -> LabelledRecording:
    return LabelledRecording(OutputRecording(serial, np.arange(len(output)) / 50, output, 50.0), force_N, unit)


def pair(measured_data: Path) -> list[LabelledRecording]:
    tables = [pd.read_csv(measured_data / f"egain_pair/{name}.csv") for name in ("S1", "S2")]
    return [labelled(table["output_V"].to_numpy(), table["force_N"].to_numpy()) for table in tables]


def codes(source: LabelledRecording, other: LabelledRecording) -> list[str]:
    return [one.code for one in compare_recordings(source, other)]


@pytest.mark.parametrize("factor", UNIT_OF)
@pytest.mark.parametrize("is_source", [False, True])
def test_loads_in_another_unit_are_named(factor: float, is_source: bool, measured_data: Path) -> None:
    pairs = pair(measured_data)
    for source, target in (pairs, pairs[::-1]):
        other = labelled(target.unlabelled.output, target.reference * factor)
        (difference,) = compare_recordings(other, source) if is_source else compare_recordings(source, other)
        assert difference.code == "inspect.other_unit" and UNIT_OF[factor] in str(difference)
        assert codes(source, target) == []


def test_a_pressure_in_psi_is_named(measured_data: Path) -> None:
    source, target = pair(measured_data)
    source, target = (labelled(one.unlabelled.output, one.reference, "kPa") for one in (source, target))
    (difference,) = compare_recordings(source, labelled(target.unlabelled.output, target.reference / 6.89476, "kPa"))
    assert "psi" in str(difference)


def test_a_sign_is_named_for_the_column_that_has_it(measured_data: Path) -> None:
    source, target = pair(measured_data)
    turned = [
        labelled(target.unlabelled.output, -target.reference),
        labelled(-target.unlabelled.output, target.reference),
    ]
    for column, other in zip(("reference", "output"), turned, strict=True):
        (difference,) = compare_recordings(source, other)
        assert difference.code == "inspect.other_sign" and difference.values["column"] == column


@pytest.mark.parametrize("gain", [0.3, 3.0])
def test_a_sensor_that_answers_less_or_a_lighter_press_is_no_other_unit(gain: float, measured_data: Path) -> None:
    source, target = pair(measured_data)
    assert codes(source, labelled(target.unlabelled.output * gain, target.reference)) == []
    assert codes(source, labelled(target.unlabelled.output * gain, target.reference * gain)) == []
    light = labelled(target.unlabelled.output / 9.81, target.reference / 9.81)
    assert codes(source, light) == []


@pytest.mark.filterwarnings("error")
def test_a_channel_that_never_moves_is_not_compared(measured_data: Path) -> None:
    source, target = pair(measured_data)
    still = np.full(len(target), 0.5)
    for other in (labelled(still, target.reference), labelled(target.unlabelled.output, still)):
        assert codes(source, other) == codes(other, source) == []


def test_no_two_measured_places_of_a_skin_are_named(measured_data: Path) -> None:
    tables = [pd.read_parquet(path) for path in sorted((measured_data / "skin_places").glob("*.parquet"))]
    recordings = [labelled(table["output_V"].to_numpy(), table["force_N"].to_numpy()) for table in tables]
    assert [codes(one, other) for one in recordings for other in recordings] == [[]] * len(recordings) ** 2
