"""Recordings to try softcal with, where no rig is at hand."""

import numpy as np

from softcal.app.api.arguments import number, show_value, whole_number
from softcal.app.api.recording import Recording
from softcal.core.errors import InputError


def simulate_recordings(units: int = 1, *, duration_s: float = 12.0, seed: int = 1) -> list[Recording]:
    """Simulate recordings of soft sensors under a load cell: the source first, then so many units.

    They are those of the simulator that `Twin` is: the same material in every unit, another gain and another rest.

    >>> import softcal
    >>> source, first, second = softcal.simulate_recordings(units=2)
    >>> second
    <Recording S3: 600 samples at 50 Hz (12 s), output in V, reference in N>

    Args:
        units: how many units beside the source.
        duration_s: of each recording.
        seed: equal seeds give equal recordings.

    Raises:
        InputError: a number is out of range.
    """
    from softcal.core.profiles import unit_profile
    from softcal.core.simulated_lot import draw_twins
    from softcal.core.twin.simulate import simulate

    time_s = number("duration_s", duration_s, "a number of seconds")
    if not 1 <= time_s <= 3600:
        raise InputError(f"duration_s is {show_value(duration_s)}; 1 to 3600 s was expected")
    rng = np.random.default_rng(whole_number("seed", seed, 0))
    recordings = []
    for k, twin in enumerate(draw_twins(rng, 1 + whole_number("units", units, 0)), 1):
        rate_Hz = twin.metadata.sample_rate_Hz
        t_s, stage_mm = unit_profile(rng, time_s).sample(rate_Hz)
        force_N, output_V = simulate(twin, t_s, stage_mm, rng)
        rows = slice(round(time_s * rate_Hz))
        recordings.append(Recording(output_V[rows], force_N[rows], rate_Hz, t_s[rows], f"S{k}"))
    return recordings
