"""Maps of a lot in Python, fitted together by the load that its units share with each other."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from softcal.app.api.fitting import read_recordings
from softcal.app.api.network import SourceNetwork
from softcal.app.api.recording_input import recording_of
from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps import shared_load, source_bias
from softcal.core.maps.config import SharedLoadConfig
from softcal.core.maps.interface import mapped_segments
from softcal.core.recording import Array

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, repr=False)
class LotMaps:
    """The maps of a lot that were fitted together.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> list(softcal.fit_lot(network, {"S2": target, "S3": target.output * 1.1, "S4": target.output * 0.9}))
    ['S2', 'S3', 'S4']

    Args:
        network: the shared network f.
        fit: common loads, maps and uncertainties by serial, and why a unit stands alone.
    """

    network: SourceNetwork
    fit: shared_load.LotFit

    def __iter__(self) -> Iterator[str]:
        return iter(self.fit.units)

    def __len__(self) -> int:
        return len(self.fit.units)

    def to_frame(self) -> "pd.DataFrame":
        """Return one row a unit: its map, its part in the common load, and why it stands alone.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> units = {f"S{k}": target.output * gain for k, gain in enumerate((1.0, 0.9, 1.2), 2)}
        >>> softcal.fit_lot(network, units).to_frame()["group"].to_list()
        [0, 0, 0]

        Returns:
            Columns `serial`, `family`, `group` (units of one common load; empty where it stands alone), `weight` (its
            share of that load), `moved_rmse` (how far its own map was from the others), `unit_rmse` and `common_rmse`
            (standard uncertainties of the unit's part and of the common load, in the reference unit) and `reason`.
        """
        import pandas as pd

        rows = [
            {
                "serial": serial,
                "family": unit.unit_map.family,
                "group": unit.group,
                "weight": unit.weight,
                "moved_rmse": unit.moved_rmse,
                "unit_rmse": unit.unit_rmse,
                "common_rmse": None if unit.group is None else self.fit.groups[unit.group].common_rmse,
                "reason": "" if unit.reason is None else str(unit.reason),
            }
            for serial, unit in self.fit.units.items()
        ]
        rows += [{"serial": serial, "reason": str(reason)} for serial, reason in self.fit.refused.items()]
        return pd.DataFrame(rows).astype({"group": "Int64"})

    def estimate(self, serial: str, recording: Any) -> Array:
        """Estimate the reference of one unit's recording, sample by sample.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> lot = softcal.fit_lot(network, {"S2": target, "S3": target.output * 1.1, "S4": target.output * 0.9})
        >>> lot.estimate("S3", target.output * 1.1).shape == target.output.shape
        True

        Returns:
            (n,) estimates in the reference unit; NaN where no full window ends.

        Raises:
            UnitRefused: the unit has no map; the line says why.
            InputError: there is no unit of that serial, or the output is unusable.
        """
        if serial in self.fit.refused:
            raise UnitRefused(f"{serial}: {self.fit.refused[serial]}")
        if serial not in self.fit.units:
            raise InputError(f"there is no unit {serial!r}; the lot has {', '.join(list(self)[:12])}")
        source = self.network.model.source.unlabelled
        target = recording_of(recording, "recording", source.sample_rate_Hz, output_unit=source.output_unit)
        estimates = np.full(len(target.unlabelled), np.nan)
        for rows, windows in mapped_segments(self.fit.units[serial].unit_map, target.unlabelled):
            estimates[rows] = self.network.network.evaluate(windows)
        return estimates

    def __repr__(self) -> str:
        members = len(self.fit.members)
        return f"<LotMaps of {len(self)}: {members} share a load, {len(self) - members} stand alone>"


def fit_lot(network: SourceNetwork, units: Any, *, sample_rate_Hz: Any = None, **recording: Any) -> LotMaps:
    """Fit the maps of a lot together, from the outputs alone: units that were pressed by one load at once share it.

    Each unit's own map says where its load is, and each errs in its own way. Their weighted mean is the common load,
    and every map is fitted to pairs with that of the others. The source need not have been pressed with them, nor
    alike.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> softcal.fit_lot(network, {"S2": target, "S3": target.output * 1.1, "S4": target.output * 0.9})
    <LotMaps of 3: 3 share a load, 0 stand alone>

    Args:
        network: from `fit_network`.
        units: recordings as `fit_map` takes them: a dict by serial, or a list.
        sample_rate_Hz: samples a second, where the data have no time of their own; by default the source's.
        recording: other arguments of `Recording`, or of `Recording.from_frame` for DataFrames.

    Raises:
        InputError: the units are none, a serial stands twice, or an output is unusable.
    """
    options = {"sample_rate_Hz": sample_rate_Hz, **recording}
    targets = [one.unlabelled for one in read_recordings(network, units, options)]
    model = network.model
    return LotMaps(network, shared_load.fit_lot(model.source, model.network, targets, model.method.map))


def compare_sources(lots: Iterable[LotMaps]) -> "pd.DataFrame":
    """Hold against each other what the networks of several sources read of one lot.

    >>> import softcal
    >>> source, other, target = softcal.simulate_recordings(units=2)
    >>> units = {"T1": target, "T2": target.output * 1.1, "T3": target.output * 0.9}
    >>> lots = [softcal.fit_lot(softcal.fit_network(one, hidden=(8,)), units) for one in (source, other)]
    >>> list(softcal.compare_sources(lots)["source"])
    ['S1', 'S2']

    Args:
        lots: fits of the same recordings, each by the network of another source.

    Returns:
        A row a source: `bias` and `rmse` (mean and RMS of the common load it reads, less that of another source, in the
        reference unit), `uncertainty` (what two of the others differ by), `others` (sources it is held against) and
        `is_bad`. Of two sources nobody can say which one errs.
    """
    import pandas as pd

    groups = {lot.network.model.source.serial: lot.fit.groups for lot in lots}
    biases = source_bias.compare_sources(groups, SharedLoadConfig())
    rows = [{"source": serial, **vars(one), "is_bad": one.is_bad} for serial, one in biases.items()]
    return pd.DataFrame(rows, columns=["source", "bias", "rmse", "uncertainty", "others", "is_bad"])
