"""Score a map on an audit recording: before, after and own calibration on the same held-out rows."""

from dataclasses import dataclass

from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.interface import UnitMap
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording
from softcal.core.unit.method import DecisionConfig


@dataclass(frozen=True)
class Scores:
    """Errors on one audit recording, in the reference unit.

    Args:
        before: RMSE of f on raw windows.
        after: RMSE of f on mapped windows.
        own: RMSE of a network trained on the unit's own labels; None where there are too few of them.
    """

    before: float
    after: float
    own: float | None


def score_map(
    network: Network,
    unit_map: UnitMap,
    audit: LabelledRecording,
    own: NetworkConfig | None,
    config: DecisionConfig = DecisionConfig(),  # noqa: B008 - frozen
) -> Scores:
    """Score a unit on the last quarter of its audit recording, by time (Kim et al. 2020, Table 1).

    Args:
        network: the shared network f.
        unit_map: the unit's map.
        audit: labelled recording of the unit that no fit has seen.
        own: how to train the unit's own calibration on the first three quarters; None leaves it out.
        config: which share is tested.
    """
    # By time and never at random: a later stretch is what the unit will be used on.
    split = round(len(audit) * (1 - config.test_share))
    test = audit.part(split, len(audit))
    truth = test.window_reference
    return Scores(
        before=rmse(network.evaluate(test.windows), truth),
        after=rmse(network.evaluate(unit_map.apply(test.windows)), truth),
        own=None if own is None else _own_rmse(audit.part(0, split), test, own, config.least_own_windows),
    )


def _own_rmse(train: LabelledRecording, test: LabelledRecording, config: NetworkConfig, least: int) -> float | None:
    try:
        if len(train.windows) < least:
            return None
        trained = fit_network(train, config)
    except (UnitRefused, InputError):
        return None
    return rmse(trained.network.evaluate(test.windows), test.window_reference)
