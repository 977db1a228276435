"""A sensor's level under a known load is read only where it stands still and differs from every other level."""

import numpy as np
import pytest

from softcal.core.errors import InputError
from softcal.core.quality.known_loads import KnownLoad, loads_text, parse_loads
from softcal.core.quality.reading_at_rest import ReadingConfig, level_at_rest

CONFIG = ReadingConfig()
RUN = np.concatenate([np.full(100, 1.0), np.linspace(1.0, 3.0, 200)])
SPAN, ALTERNATING = 2.0, np.resize([1.0, -1.0], 60)


def read(output: np.ndarray, before: tuple[float, ...] = (), load: float = 1.0) -> float:
    return level_at_rest(output, RUN, KnownLoad(load), before, CONFIG)


def test_what_stands_still_is_its_mean():
    assert read(1.5 + 0.9 * CONFIG.restless * SPAN * ALTERNATING) == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("output", "before", "code"),
    [
        (1.5 + 1.1 * CONFIG.restless * SPAN * ALTERNATING, (), "load.unsteady"),
        (1.5 + np.repeat([0.0, 1.1 * CONFIG.drift * SPAN], 30), (), "load.unsteady"),
        (1.5 - np.repeat([0.0, 1.1 * CONFIG.drift * SPAN], 30), (), "load.unsteady"),
        (np.full(60, 1.0 + 1.8 * CONFIG.drift * SPAN), (), "load.unloaded"),
        (np.full(60, 1.5), (1.5 - 1.8 * CONFIG.drift * SPAN,), "load.same"),
    ],
    ids=["restless", "rises", "falls", "no load on it", "the load before"],
)
def test_a_level_that_says_nothing_is_refused(output, before, code):
    with pytest.raises(InputError) as refused:
        read(output, before)
    assert refused.value.reason.code == code


def test_the_unloaded_level_is_no_reading_without_a_load():
    assert read(np.full(60, 1.0), load=0.0) == 1.0


def test_a_load_whose_uncertainty_nobody_stated_is_not_said_to_be_exact():
    assert (str(KnownLoad(2.0)), str(KnownLoad(2.0, 0.0021))) == ("2", "2 ± 0.0021")
    loads = KnownLoad(0.0), KnownLoad(2.0, 0.002)
    assert parse_loads(loads_text(loads)) == loads and loads[0].expanded is None
