"""A sensor one can check by hand: output = 0.5 V + 0.1 V/N * force, and the network that inverts exactly this."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from softcal.core.challenge.case_generator import draw_case
from softcal.core.challenge.cases import SealedCase
from softcal.core.gap.case import Case, Run
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.unit.method import Method
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.windows import TAPS

RATE_HZ = 50.0
NOISE_V = 0.002

Press = Callable[..., LabelledRecording]


@pytest.fixture(scope="session")
def linear_network() -> Network:
    """10 N/V * (newest sample - 0.5 V), by two ReLU that stand back to back."""
    newest = np.zeros((TAPS, 2))
    newest[-1] = [1.0, -1.0]
    return Network((newest, np.array([[1.0], [-1.0]])), (np.zeros(2), np.zeros(1)), 0.5, 0.1, 0.0, 1.0)


@pytest.fixture(scope="session")
def press() -> Press:
    """`press(seed, gain, offset, seconds)`: random presses of 0.5 to 3 N with rests, labelled."""

    def record(
        seed: int, gain: float = 1.0, offset_V: float = 0.0, seconds: float = 60.0, serial: str = "U1"
    ) -> LabelledRecording:
        rng = np.random.default_rng(seed)
        pieces = [np.zeros(100)]
        while sum(map(len, pieces)) < seconds * RATE_HZ:
            up, down, hold, rest = (int(n) for n in rng.integers((10, 10, 1, 5), (80, 80, 60, 60)))
            peak = 3.0 if len(pieces) < 30 and len(pieces) % 4 == 2 else rng.uniform(0.5, 3.0)
            pieces += [np.linspace(0, peak, up), np.full(hold, peak), np.linspace(peak, 0, down), np.zeros(rest)]
        force_N = np.concatenate(pieces)[: int(seconds * RATE_HZ)]
        output_V = offset_V + gain * (0.5 + 0.1 * force_N + rng.normal(0, NOISE_V, len(force_N)))
        t_s = np.arange(len(force_N)) / RATE_HZ
        return LabelledRecording(OutputRecording(serial, t_s, output_V, RATE_HZ), force_N)

    return record


@pytest.fixture(scope="session")
def source_model(press: Press, linear_network: Network) -> SourceModel:
    source = press(1, serial="S0", seconds=120.0)
    return make_source_model(source, linear_network, np.arange(0, len(source.windows), 4), method=Method())


@pytest.fixture(scope="session")
def opened_case() -> Callable[[SealedCase], Case]:
    """`opened_case(sealed)`: the recordings of a rig of the second implementation, rounded like their files."""

    def opened(sealed: SealedCase) -> Case:
        rig = sealed.rig
        readout = ReadoutMetadata(rig.vref_V, rig.adc_bits, rig.r_series_ohm, rig.sample_rate_Hz)
        runs = []
        for number, run in enumerate(sealed.write_runs(sealed.plans), start=1):
            measured = run.measured
            columns = {name: np.round(values, 6) for name, values in measured.columns.items()}
            run_readout = replace(readout, sample_rate_Hz=run.sample_rate_Hz)
            runs.append(Run(f"runs/{number}", readout=run_readout, profile=measured.profile, **columns))
        return Case(sealed.name, tuple(runs))

    return opened


@pytest.fixture
def drawn_case(opened_case: Callable[[SealedCase], Case]) -> Callable[[int, str, str], Case]:
    """`drawn_case(seed, name, line)`: the recordings of a rig that is drawn from a line."""
    return lambda seed, name, line: opened_case(draw_case(seed, name, line))
