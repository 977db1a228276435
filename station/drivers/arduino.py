"""The sensor's readout: an Arduino that prints raw converter counts, one or several channels a line."""

from dataclasses import dataclass, replace

from softcal.core.errors import InputError
from softcal.core.words.reason import reason
from softcal.station.devices.config import ReadoutConfig
from softcal.station.devices.driver import Driver, Opening, Simulated, Surroundings
from softcal.station.drivers.text_stream import TextStream
from softcal.station.interfaces import Sample
from softcal.station.wire.link import Link, link_for_driver
from softcal.station.wire.transport import WireKind


@dataclass(frozen=True)
class ArduinoConfig(ReadoutConfig):
    """A converter behind a divider.

    Args:
        baud_rate: of its port.
        vref_V, adc_bits: full scale and resolution of the converter.
        r_series_ohm: series resistor of the divider.

    Raises:
        InputError: a converter that cannot be.
    """

    kind: str = "arduino"
    baud_rate: int = 115200
    vref_V: float = 5.0
    adc_bits: int = 10
    r_series_ohm: float = 10.0

    def __post_init__(self) -> None:
        if not self.vref_V > 0:
            raise InputError(reason("station_file.positive", name="readout.vref_V", value=self.vref_V))
        if not 1 <= self.adc_bits <= 32:
            raise InputError(
                reason("station_file.outside", name="readout.adc_bits", value=self.adc_bits, low=1, high=32)
            )


class ArduinoReadout:
    """Converter counts as V: count / (2**bits - 1) * reference.

    Args:
        link: its port.
        vref_V: full scale of the converter.
        adc_bits: its resolution.
        rate_Hz: lines per second.
        channels: sensors read at once.
    """

    unit = "V"
    name = "sensor readout"

    def __init__(
        self, link: Link, vref_V: float = 5.0, adc_bits: int = 10, rate_Hz: float = 50.0, channels: int = 1
    ) -> None:
        self.rate_Hz, self.channels = rate_Hz, channels
        self.range = (0.0, vref_V)
        self.stream = TextStream(self.name, link, channels, rate_Hz)
        self._step_V = vref_V / (2**adc_bits - 1)

    def start(self) -> None:
        self.stream.start()

    def poll(self) -> list[Sample]:
        return [replace(s, values=tuple(count * self._step_V for count in s.values)) for s in self.stream.poll()]

    def close(self) -> None:
        self.stream.close()


def open_arduino(config: ArduinoConfig, opening: Opening) -> ArduinoReadout:
    """Open the readout a station file describes.

    Raises:
        NoReply: its port cannot be opened.
    """
    with link_for_driver(config.port, opening.clock, config.baud_rate, ArduinoReadout.name) as link:
        return ArduinoReadout(link, config.vref_V, config.adc_bits, config.rate_Hz, config.channels)


def _simulate(around: Surroundings) -> Simulated[ArduinoConfig]:
    from softcal.station.simulated.text_stream import SimulatedTextStream

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


_WIRES: tuple[WireKind, ...] = ("serial", "tcp", "ble")
DRIVERS = (Driver("arduino", "text lines `ms,adc[,adc ...]`", ArduinoConfig, open_arduino, _simulate, _WIRES),)
