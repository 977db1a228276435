"""The sensor's readout: an Arduino that prints raw counts, one or several channels a line."""

from dataclasses import dataclass

from softcal.station.device_names import READOUT
from softcal.station.devices.config import ReadoutConfig, check_positive, check_within
from softcal.station.devices.driver import Driver, Simulated, Surroundings, make_opener
from softcal.station.drivers.text_stream import WIRES, TextStream
from softcal.station.messages import PAGES
from softcal.station.simulated.text_stream import SimulatedTextStream
from softcal.station.wire.link import Link


@dataclass(frozen=True)
class ArduinoConfig(ReadoutConfig):
    """A converter behind a divider.

    Args:
        baud_rate: of its port.
        vref_V, adc_bits: full scale and resolution of the converter.
        r_series_ohm: series resistor of the divider.
    """

    kind: str = "arduino"
    baud_rate: int = 115200
    vref_V: float = 5.0
    adc_bits: int = 10
    r_series_ohm: float = 10.0

    def __post_init__(self) -> None:
        check_positive("readout.vref_V", self.vref_V)
        check_within("readout.adc_bits", self.adc_bits, 1, 32)


class ArduinoReadout(TextStream):
    """Converter counts as V: count / (2**bits - 1) * reference."""

    unit = "V"

    def __init__(
        self, link: Link, vref_V: float = 5.0, adc_bits: int = 10, rate_Hz: float = 50.0, channels: int = 1
    ) -> None:
        super().__init__(READOUT, link, channels, rate_Hz)
        self.range = (0.0, vref_V)
        self._step_V = vref_V / (2**adc_bits - 1)

    def values_of(self, counts: tuple[int, ...]) -> tuple[float, ...]:
        return tuple(count * self._step_V for count in counts)


def _simulate(around: Surroundings) -> Simulated[ArduinoConfig]:
    electronics = around.electronics

    def counts(now_s: float) -> tuple[int, ...]:
        return tuple(round(output_V / electronics.step_V) for output_V in around.outputs_V(now_s))

    drift = float(around.rng.normal(0, 1e-3))
    config = ArduinoConfig(
        around.wire.port,
        rate_Hz=electronics.sample_rate_Hz,
        channels=len(around.outputs_V(0.0)),
        vref_V=electronics.vref_V,
        adc_bits=electronics.adc_bits,
        r_series_ohm=electronics.r_series_ohm,
    )
    return Simulated(config, SimulatedTextStream(around.wire, counts, electronics.sample_rate_Hz, drift))


_OPEN = make_opener(
    READOUT, lambda link, config: ArduinoReadout(link, config.vref_V, config.adc_bits, config.rate_Hz, config.channels)
)
_DESCRIPTION = "text lines `ms,adc[,adc ...]`"
DRIVERS = (Driver("arduino", _DESCRIPTION, ArduinoConfig, _OPEN, _simulate, WIRES, messages=PAGES["text_stream"]),)
