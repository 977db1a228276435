"""What a unit costs on an end device, told before anything is flashed."""

from dataclasses import dataclass

from softcal.core.export.integer_network import DeviceMap, IntegerNetwork

STATE_BYTES, BYTES_PER_WIDTH, LEAST_WIDTH = 104, 4, 16
"""Of `ss_sensor` on a 32-bit machine: its fixed part, and two buffers as wide as the widest layer."""

PER_MULTIPLICATION, PER_ROW, ALWAYS, PER_MIX = 4.0, 45.0, 570.0, 2500.0
"""Instructions of a Cortex-M0, fitted to counts in QEMU at -Os (benchmarks/export_device.py)."""

CYCLES_PER_INSTRUCTION, CLOCK_kHz = 1.36, 48_000.0
"""Of a Cortex-M0+ with one flash wait state, from a cycle model; right to about 10 %."""


@dataclass(frozen=True)
class DeviceCost:
    """One estimate on a Cortex-M0+ at 48 MHz.

    Args:
        ram_bytes: of `ss_sensor`; the stack comes on top.
        instructions: of one new sample and its estimate.
        estimate_ms: the same in time.
    """

    ram_bytes: int
    instructions: int
    estimate_ms: float


def device_cost(network: IntegerNetwork, device_map: DeviceMap) -> DeviceCost:
    """Return what a sample and its estimate cost."""
    padded = [rows + -rows % 4 for rows in network.sizes[1:]]
    multiplications = sum(columns * rows for columns, rows in zip(network.sizes[:-1], padded, strict=True))
    instructions = PER_MULTIPLICATION * multiplications + PER_ROW * sum(padded) + ALWAYS
    instructions += PER_MIX * (device_map.mix is not None)
    return DeviceCost(
        STATE_BYTES + BYTES_PER_WIDTH * max(LEAST_WIDTH, *padded),
        round(instructions),
        instructions * CYCLES_PER_INSTRUCTION / CLOCK_kHz,
    )
