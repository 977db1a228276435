"""The sensor's readout: an Arduino that prints raw converter counts, one or several channels a line."""

from dataclasses import replace

from softcal.station.drivers.text_stream import TextStream
from softcal.station.interfaces import Sample
from softcal.station.link import Link


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
        """Throw away what lies in the buffers and begin to count."""
        self.stream.start()

    def poll(self) -> list[Sample]:
        """Return the samples that arrived since the last call, in V."""
        return [replace(s, values=tuple(count * self._step_V for count in s.values)) for s in self.stream.poll()]

    def close(self) -> None:
        """Give the port back."""
        self.stream.close()
