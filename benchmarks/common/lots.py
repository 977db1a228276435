"""A lot folder of any size for the benchmarks of batch: recordings of simulated units, each unlike every other."""

from pathlib import Path

import numpy as np

from softcal.app.files.lot_folder import write_lot_toml
from softcal.core.lot import Lot
from softcal.core.profiles import source_profile, unit_profile
from softcal.core.simulated_lot import DEPTH_MM, draw_twins
from softcal.core.twin.simulate import simulate

RATE_HZ = 50.0
SAMPLES = 1250
SIMULATED = 40
"""Units that are simulated; all the others repeat one of them with a gain, an offset and noise of their own."""


def make_lot(folder: Path, units: int, source_s: float = 100.0, seed: int = 0) -> Path:
    """Write a lot folder of `units` recordings of 1,250 samples and a source of 5,000; return it."""
    rng = np.random.default_rng(seed)
    twins = draw_twins(rng, SIMULATED + 1)
    for name in ("source", "units"):
        (folder / name).mkdir(parents=True)
    write_lot_toml(folder, Lot(folder.name, "S0", RATE_HZ))
    t_s, stage_mm = source_profile(rng, source_s, DEPTH_MM).sample(RATE_HZ)
    force_N, output_V = simulate(twins[0], t_s, stage_mm, rng)
    rows = np.column_stack([t_s, output_V, force_N])
    np.savetxt(folder / "source/S0.csv", rows, "%.9g", ",", header="t_s,output,reference", comments="")
    outputs_V = []
    for twin in twins[1:]:
        t_s, stage_mm = unit_profile(rng, SAMPLES / RATE_HZ, DEPTH_MM).sample(RATE_HZ)
        outputs_V.append(simulate(twin, t_s, stage_mm, rng)[1][:SAMPLES])
    stamps = [f"{k / RATE_HZ:.2f}" for k in range(SAMPLES)]
    for k in range(units):
        output_V = _varied(rng, outputs_V[k % SIMULATED])
        lines = "\n".join(f"{t},{v:.6f}" for t, v in zip(stamps, output_V.tolist(), strict=True))
        (folder / f"units/U{k:06d}.csv").write_text(f"t_s,output\n{lines}\n")
    return folder


def _varied(rng: np.random.Generator, output_V: np.ndarray) -> np.ndarray:
    middle_V = output_V.mean()
    gain, offset_V = rng.normal(1.0, 0.1), rng.normal(0.0, 0.02)
    return np.asarray(middle_V + offset_V + gain * (output_V - middle_V) + rng.normal(0.0, 2e-4, len(output_V)))
