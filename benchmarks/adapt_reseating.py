"""How soon a re-seating is followed, and what it costs until then: many re-seatings of a simulated gait.

python benchmarks/adapt_reseating.py
"""

import numpy as np
from adapt_common import calibrate, print_markdown
from simulated_gait import RATE_HZ, Sensor, walk

from softcal.core.network.config import NetworkConfig
from softcal.core.recording import Array
from softcal.core.use.batches import MapUpdate
from softcal.core.use.tracker import JUMPED, TRIED

SEATS, EVERY = 24, 5000
"""Re-seatings in a stream, and samples between them."""

GAIN_SD, OFFSET_SD_V = 0.04, 0.06


def seated(rng: np.random.Generator) -> tuple[Array, Array, Array, list[int]]:
    """Return t_s, output_V, force_N and the samples at which gain and offset changed at once."""
    force_N = walk((SEATS + 1) * EVERY / RATE_HZ, rng)
    t_s, output_V = Sensor(rng).read(force_N)
    places = [(k + 1) * EVERY + int(rng.integers(0, 60)) for k in range(SEATS)]
    for place, end in zip(places, [*places[1:], len(t_s)], strict=True):
        output_V[place:end] = output_V[place:end] * (1 + rng.normal(0, GAIN_SD)) + rng.normal(0, OFFSET_SD_V)
    return t_s, output_V, force_N, places


def main() -> None:
    rng = np.random.default_rng(9)
    force_N = walk(180.0, rng)
    unit = calibrate(*Sensor(rng).read(force_N), force_N, RATE_HZ, NetworkConfig(hidden=(40, 20), max_epochs=60))
    rows = []
    for seed in range(2):
        t_s, output_V, force_N, places = seated(np.random.default_rng(seed))
        adapter = unit.adapter("improved")
        error = np.nan_to_num(adapter.advance(t_s, output_V).estimate - force_N)
        updates = adapter.take_updates()
        rest, both = (delays(updates, verdicts, places) for verdicts in ((TRIED, JUMPED), (JUMPED,)))
        calm = float(np.median([np.sqrt(np.mean(error[p + 2500 : p + 4500] ** 2)) for p in places]))
        cost = [float(np.sum(error[p : p + 2500] ** 2)) / calm**2 - 2500 for p in places]
        spread = [float(v) for delay in (rest, both) for v in np.quantile(delay, (0.1, 0.5, 0.9))]
        rows.append([seed, len(places), len(both), *spread, calm, float(np.median(cost)), float(np.mean(cost))])
    header = ["seed", "re-seatings", "told at once", "samples until the rest is followed: 10 %", "median", "90 %"]
    header += ["until the gain is: 10 %", "median", "90 %", "RMSE in calm [N]", "median cost", "mean cost"]
    print_markdown(header, rows)


def delays(updates: list[MapUpdate], verdicts: tuple[str, ...], places: list[int]) -> list[int]:
    """Return how many samples after each of the places the first update with one of the verdicts came, if one did."""
    seen = np.array([update.row for update in updates if update.verdict in verdicts])
    return [int(found[0]) for p in places if len(found := seen[(seen > p) & (seen < p + EVERY // 2)] - p)]


if __name__ == "__main__":
    main()
