"""f and γ as scikit-learn estimators, for Pipelines, cross-validation and comparison with other methods."""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from softcal.app.api.network import SourceNetwork
from softcal.app.api.recording import Recording
from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.catalogue import family
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import DEFAULT, MapConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import merge_members, validation_blocks
from softcal.core.recording import Array
from softcal.core.unit.findings import contradictions
from softcal.core.unit.health import check_alive, output_limits
from softcal.core.windows import TAPS, windows


class NetworkRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """The time-delay network f as a regressor: rows are windows, newest sample last.

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> windows, force_N = source.labelled.windows, source.labelled.window_reference
    >>> regressor = softcal.NetworkRegressor(hidden=(8,), max_epochs=20).fit(windows, force_N)
    >>> regressor.predict(windows).shape == force_N.shape
    True

    Args:
        hidden: widths of the hidden layers (Kim et al. 2020: 120, 70, 35).
        random_state: drives initial weights and batch order.
        members: networks averaged into one.
        max_epochs: passes over the rows at most; a share of the rows, in blocks, says when to stop.

    Attributes:
        network_: f as plain arrays.
        n_iter_: epochs trained, the most of all members.
    """

    def __init__(
        self, hidden: tuple[int, ...] = (120, 70, 35), random_state: int = 0, members: int = 1, max_epochs: int = 200
    ) -> None:
        self.hidden = hidden
        self.random_state = random_state
        self.members = members
        self.max_epochs = max_epochs

    def fit(self, X: Any, y: Any) -> "NetworkRegressor":  # noqa: N803 - scikit-learn's name
        """Train on (n, p) rows and (n,) references; neighbouring rows are taken as neighbours in time.

        >>> import numpy as np, softcal
        >>> windows = np.random.default_rng(0).normal(size=(200, 15))
        >>> regressor = softcal.NetworkRegressor(hidden=(8,), max_epochs=20).fit(windows, windows[:, -1])
        >>> regressor.n_iter_ <= 20
        True
        """
        X, y = validate_data(self, X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=4)
        from softcal.core.network.training_steps import train_members

        means = (float(X.mean()), float(y.mean()))
        scales = (float(X.std()) or 1.0, float(y.std()) or 1.0)
        config = NetworkConfig(
            hidden=tuple(self.hidden), seed=self.random_state, members=self.members, max_epochs=self.max_epochs
        )
        held_out = validation_blocks(len(X), config.validation_share)
        x = ((X - means[0]) / scales[0]).astype(np.float32)
        labels = ((y - means[1]) / scales[1]).astype(np.float32)[:, None]
        members = train_members(x, labels, ~held_out, held_out, config, scales[1], None)
        layers = merge_members([layers for layers, _ in members])
        self.network_ = Network(*layers, means[0], scales[0], means[1], scales[1])
        self.n_iter_ = max(epochs for _, epochs in members)  # noqa: V101
        return self

    def predict(self, X: Any) -> Array:  # noqa: N803
        """Estimate the reference of (n, p) rows: (n,).

        >>> import numpy as np, softcal
        >>> windows = np.random.default_rng(0).normal(size=(200, 15))
        >>> regressor = softcal.NetworkRegressor(hidden=(8,), max_epochs=20).fit(windows, windows[:, -1])
        >>> regressor.predict(windows[:3]).shape
        (3,)
        """
        check_is_fitted(self)
        return self.network_.evaluate_exactly(validate_data(self, X, dtype=np.float64, reset=False))


class MapTransformer(TransformerMixin, BaseEstimator):  # type: ignore[misc]
    """The map γ of a unit as a transformer: one column of output in, (n, 15) windows of the source's space out.

    The rows are samples in time; the first 14 windows are filled up with the first sample. In a Pipeline before the
    regressor that was trained on the source:

        make_pipeline(MapTransformer(source, sample_rate_Hz=50), FrozenEstimator(regressor)).fit(output).predict(output)

    >>> import softcal
    >>> source, target = softcal.simulate_recordings()
    >>> transformer = softcal.MapTransformer(softcal.fit_network(source, hidden=(8,)))
    >>> output = target.to_frame()[["output"]]
    >>> transformer.fit(output).transform(output).shape
    (600, 15)

    Args:
        source: what `fit_network` gave.
        sample_rate_Hz: of the unit's output; by default the source's.
        family: `auto`, or the name of a family.

    Attributes:
        map_: the fitted map γ.
        family_: its family.
    """

    def __init__(
        self, source: SourceNetwork | None = None, sample_rate_Hz: float | None = None, family: str = DEFAULT
    ) -> None:
        self.source = source
        self.sample_rate_Hz = sample_rate_Hz
        self.family = family

    def fit(self, X: Any, y: Any = None) -> "MapTransformer":  # noqa: N803
        """Fit γ to (n, 1) samples of output; y is not looked at.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> output = target.to_frame()[["output"]]
        >>> transformer = softcal.MapTransformer(network).fit(output)
        >>> transformer.family_ == transformer.map_.family
        True

        Raises:
            UnitRefused: the output allows no map.
        """
        output = self._output(X, reset=True)
        if self.source is None:
            raise InputError("MapTransformer has no source; give what softcal.fit_network returned")
        source = self.source.model.source
        rate_Hz = self.sample_rate_Hz or source.unlabelled.sample_rate_Hz
        target = Recording(output, sample_rate_Hz=rate_Hz, output_unit=source.unlabelled.output_unit).unlabelled
        problem = FitProblem(source, self.source.network, target, None, MapConfig(family=self.family))
        method = self.source.model.method
        check_alive(target, source.unlabelled, method.health)
        is_rising = self.source.model.interval.slope_limit > 0
        limits = output_limits(target, source.unlabelled, is_rising, method)
        for contradiction in contradictions(source.unlabelled, target, limits, method, problem.synchrony):
            raise UnitRefused(contradiction.reason)
        chosen = choose_map(problem).unit_map if self.family == DEFAULT else family(self.family).fit(problem)
        self.map_, self.family_ = chosen, chosen.family  # noqa: V101
        return self

    def transform(self, X: Any) -> Array:  # noqa: N803
        """Carry (n, 1) samples into the source's window space: (n, 15).

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> output = target.to_frame()[["output"]]
        >>> transformer = softcal.MapTransformer(network).fit(output)
        >>> network.predict(transformer.transform(output)).shape
        (600,)
        """
        check_is_fitted(self)
        output = self._output(X, reset=False)
        return self.map_.apply(windows(np.concatenate([np.full(TAPS - 1, output[0]), output])))

    def get_feature_names_out(self, input_features: Any = None) -> Any:  # noqa: V105, V107
        """Name the columns of `transform`, oldest sample first, for `set_output(transform="pandas")`.

        >>> import softcal
        >>> source, target = softcal.simulate_recordings()
        >>> network = softcal.fit_network(source, hidden=(8,))
        >>> output = target.to_frame()[["output"]]
        >>> transformer = softcal.MapTransformer(network).fit(output)
        >>> list(transformer.get_feature_names_out()[[0, -1]])
        ['window_14', 'window_0']
        """
        check_is_fitted(self)
        return np.asarray([f"window_{ago}" for ago in reversed(range(TAPS))], dtype=object)

    def _output(self, X: Any, reset: bool) -> Array:  # noqa: N803
        table = validate_data(self, X, dtype=np.float64, reset=reset)
        if table.shape[1] != 1:
            raise ValueError(f"X has {table.shape[1]} features; one column, the unit's output, was expected")
        return np.ascontiguousarray(table[:, 0])
