"""Another programme is no drift: insole taxels calibrated in one file, streamed through the other.

python benchmarks/adapt_insole.py [--quick] [--reverse]
"""

import argparse
from collections.abc import Iterator, Sequence

import pandas as pd
from adapt_common import DATA, calibrate, follow, print_markdown

from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.use.batches import MapUpdate

RATE_HZ = 48.9


FILES = ("calibration", "validation_1")


def rows(every: int, files: Sequence[str]) -> Iterator[list[object]]:
    calibration, stream = (pd.read_parquet(DATA / "insole_lot" / f"{name}.parquet") for name in files)
    taxels = [name for name in calibration.columns if name.startswith("taxel")]
    reference = stream["pressure_bar"].to_numpy(dtype=float)
    for taxel in taxels[::every]:
        t_s, output, pressure_bar = (calibration[name].to_numpy(dtype=float) for name in ("t_s", taxel, "pressure_bar"))
        unit = calibrate(t_s, output, pressure_bar, RATE_HZ, NetworkConfig(hidden=(40, 20), max_epochs=40))
        errors: dict[str, float] = {}
        updates: list[MapUpdate] = []
        for mode in ("none", "basic", "improved"):
            estimate, updates = follow(unit, mode, stream["t_s"].to_numpy(), stream[taxel].to_numpy(dtype=float))
            errors[mode] = rmse(estimate, reference)
        moved = sum(update.gain != 1.0 for update in updates)
        yield [
            taxel,
            errors["none"],
            errors["basic"],
            errors["improved"],
            errors["improved"] / errors["none"],
            moved,
            updates[-1].reason,
        ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="every tenth taxel instead of every third")
    parser.add_argument("--reverse", action="store_true", help="calibrate in the second file, stream the first")
    options = parser.parse_args()
    header = ["taxel", "no adaptation [bar]", "basic", "improved", "improved / none", "maps", "what it says"]
    print_markdown(header, rows(10 if options.quick else 3, FILES[::-1] if options.reverse else FILES))
