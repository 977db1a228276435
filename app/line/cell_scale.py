"""Scale of the load cell by dead weights, written into the station file."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from softcal.core.errors import InputError
from softcal.station.bench.bench import open_force
from softcal.station.bench.station_file import with_driver_keys
from softcal.station.clock import HostClock
from softcal.station.devices.cell_calibration import CellCalibration, fit_cell, read_steady
from softcal.station.devices.config import StationConfig
from softcal.station.drivers.hx711 import Hx711Config


def calibrate_cell(
    config: StationConfig, masses_kg: Sequence[float], wait_for: Callable[[float], None]
) -> tuple[CellCalibration, StationConfig]:
    """Return the scale of the load cell by dead weights, and the station with that scale.

    Args:
        masses_kg: weights in the order they are put on; 0 is the unloaded cell.
        wait_for: called before each reading, returns when the weight lies still.

    Raises:
        InputError: the station has no raw load cell, or too few weights.
        DeviceError: the cell does not answer, or does not follow the weights.
    """
    cell = None if config.force is None else with_driver_keys(config.force)
    if not isinstance(cell, Hx711Config):
        raise InputError("the station has no HX711 load cell; other gauges carry their own scale")
    raw = replace(cell, counts_per_N=1.0, zero_counts=0.0)
    readings, clock = [], HostClock()
    with open_force(raw, clock) as reader:
        for mass_kg in masses_kg:
            wait_for(mass_kg)
            readings.append(read_steady(reader, clock))
    scale = fit_cell(masses_kg, [mean for mean, _ in readings], [noise for _, noise in readings])
    return scale, replace(config, force=replace(cell, counts_per_N=scale.per_N, zero_counts=scale.zero))
