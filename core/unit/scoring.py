"""Score a map on an audit: on every row that `estimate` has an estimate for, by the same map."""

import numpy as np

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.interface import UnitMap, mapped_segments
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import Array, LabelledRecording
from softcal.core.unit.estimate import GAP, WARM_UP
from softcal.core.unit.measured_error import MeasuredError, OwnCalibrationScores, Scores
from softcal.core.unit.method import DecisionConfig
from softcal.core.windows import TAPS


def score_map(
    network: Network,
    unit_map: UnitMap,
    audit: LabelledRecording,
    config: DecisionConfig,
    own_calibration: NetworkConfig | MeasuredError | None = None,
) -> Scores:
    """Score a unit on all rows of its audit that have an estimate.

    Args:
        own_calibration: how its own calibration is trained on the first three quarters of the audit, by time, and
            tested on the rest (Kim et al. 2020, Table 1); or what such a network showed there; None leaves it out.
    """
    recording, reference = audit.unlabelled, audit.reference
    raw, mapped = np.full(len(audit), np.nan), np.full(len(audit), np.nan)
    raw[recording.window_rows] = network.evaluate(recording.windows)
    for rows, windows in mapped_segments(unit_map, recording):
        mapped[rows] = network.evaluate(windows)
    first = recording.segments[0]
    warm_up = min(first.stop - first.start, TAPS - 1)
    return Scores(
        before=MeasuredError.from_estimates(raw, reference),
        after=MeasuredError.from_estimates(mapped, reference),
        own=_own_calibration_scores(raw, mapped, audit, own_calibration, config),
        unscored={WARM_UP: warm_up, GAP: len(audit) - len(recording.window_rows) - warm_up},
    )


def _own_calibration_scores(
    raw: Array,
    mapped: Array,
    audit: LabelledRecording,
    own_calibration: NetworkConfig | MeasuredError | None,
    config: DecisionConfig,
) -> OwnCalibrationScores | None:
    # By time and never at random: a later stretch is what the unit will be used on.
    split = round(len(audit) * 0.75)
    test = audit.part(split, len(audit))
    error = own_calibration if isinstance(own_calibration, MeasuredError) else None
    if isinstance(own_calibration, NetworkConfig):
        error = _own_calibration_error(audit.part(0, split), test, own_calibration, config.min_own_windows)
    if error is None:
        return None
    rows = split + test.unlabelled.window_rows
    before, after = (MeasuredError.from_estimates(each[rows], audit.reference[rows]) for each in (raw, mapped))
    return OwnCalibrationScores(before, after, error)


def _own_calibration_error(
    train: LabelledRecording, test: LabelledRecording, config: NetworkConfig, min_windows: int
) -> MeasuredError | None:
    try:
        if len(train.windows) < min_windows:
            return None
        trained = fit_network(train, config)
    except (UnitRefused, InputError):
        return None
    return MeasuredError.from_estimates(trained.network.evaluate(test.windows), test.window_reference)
