"""The shared network f in Python: trained on the recording of the source."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from softcal.app.api.arguments import show_value, whole_number
from softcal.app.api.display import html_table
from softcal.app.api.recording_input import labelled_of, recording_with
from softcal.core.errors import InputError
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network as train_network
from softcal.core.recording import Array
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.windows import TAPS


@dataclass(frozen=True, eq=False, repr=False)
class SourceNetwork:
    """The shared network f with the source it was trained on: what every unit's map starts from.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> network = softcal.fit_network(source, hidden=(8,))
    >>> network.reference_unit, network.network.sizes
    ('N', (15, 8, 1))

    Args:
        model: the source as units are compared with it.
        held_out: (m,) whether a window of the source was held out of the training.
        validation_rmse: error of f on those windows, in the reference unit.
    """

    model: SourceModel
    held_out: Any = field(repr=False)
    validation_rmse: float

    def __repr__(self) -> str:
        error = f"validation RMSE {self.validation_rmse:.3g} {self.reference_unit}"
        return (
            f"<SourceNetwork {'-'.join(map(str, self.network.sizes))}, trained on {self.model.source.serial}: {error}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            ("trained on", f"{self.model.source.serial}, {len(self.model.source)} samples"),
            ("layers", "-".join(map(str, self.network.sizes))),
            ("validation RMSE", f"{self.validation_rmse:.3g} {self.reference_unit}"),
        ]
        return html_table("SourceNetwork", rows)

    @property
    def network(self) -> Network:
        """f as plain arrays."""
        return self.model.network

    @property
    def reference_unit(self) -> str:
        """Physical unit of the estimates."""
        return self.network.reference_unit

    def predict(self, windows: Any) -> Array:
        """Estimate the reference for (n, 15) windows of the source, newest sample last: (n,).

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> network.predict(source.labelled.windows).shape == source.labelled.window_reference.shape
        True

        Raises:
            InputError: the windows are no (n, 15) numbers.
        """
        try:
            table = np.asarray(windows, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"windows is {show_value(windows)}; (n, {TAPS}) numbers were expected") from error
        if table.ndim != 2 or table.shape[1] != TAPS or not np.isfinite(table).all():
            raise InputError(f"windows has the shape {table.shape}; (n, {TAPS}) finite numbers were expected")
        return self.network.evaluate(table)


def fit_network(
    source: Any,
    reference: Any = None,
    *,
    sample_rate_Hz: Any = None,
    hidden: tuple[int, ...] = (120, 70, 35),
    seed: int = 0,
    members: int = 1,
    **recording: Any,
) -> SourceNetwork:
    """Train the shared network f on the source unit's recording.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> softcal.fit_network(source, hidden=(8,)).network.sizes
    (15, 8, 1)

    Arrays and tables go in without a `Recording`:

    >>> network = softcal.fit_network(source.output, source.reference, sample_rate_Hz=50, hidden=(8,))
    >>> table = source.to_frame().rename(columns={"output": "V", "reference": "F"})
    >>> network = softcal.fit_network(table, output="V", reference="F", hidden=(8,))

    Args:
        source: `Recording` with a reference, a DataFrame, or the output alone: (n,) array, list or Series.
        reference: (n,) load beside the output, or the name of its column in the DataFrame.
        sample_rate_Hz: samples a second, where the data have no time of their own.
        hidden: widths of the hidden layers; the default is the paper's (Kim et al. 2020).
        seed: equal seeds give equal networks on one machine.
        members: networks from consecutive seeds, averaged into one.
        recording: other arguments of `Recording`, or of `Recording.from_frame` for a DataFrame.

    Raises:
        InputError: no reference, too short, constant, saturated, or nothing to learn.
    """
    if not isinstance(hidden, tuple | list | np.ndarray) or np.ndim(hidden) != 1:
        raise InputError(
            f"hidden is {show_value(hidden)}; widths of the hidden layers, for example (120, 70, 35), were expected"
        )
    config = NetworkConfig(
        hidden=tuple(whole_number("hidden", width, 1) for width in hidden),
        seed=whole_number("seed", seed, 0),
        members=whole_number("members", members, 1),
    )
    options = {"reference": reference, "sample_rate_Hz": sample_rate_Hz, **recording}
    labelled = labelled_of(recording_with(source, "source", options), "source", "fit_network")
    training = train_network(labelled, config)
    model = make_source_model(labelled, training.network, training.validation_rows, method=Method())
    return SourceNetwork(model, training.validation_rows, training.validation_rmse)
