"""Programmes of presses: loads in N, sampled evenly, that one seed makes anew on every machine."""

import numpy as np


def presses(seed: int, count: int, dwell: float = 0.0) -> np.ndarray:
    """Return presses to 1 ... 3 N at random speeds; rests last about `dwell` samples longer than 5."""
    rng, parts, length = np.random.default_rng(seed), [np.zeros(10)], 10
    while length < count:
        peak, up, down = rng.uniform(1.0, 3.0), rng.integers(10, 40), rng.integers(10, 40)
        rest = np.zeros(5 + int(rng.exponential(dwell)) if dwell else 5)
        parts += [np.linspace(0, peak, up), np.linspace(peak, 0, down), rest]
        length += up + down + len(rest)
    return np.concatenate(parts)[:count]


def dwelling_presses(seed: int, count: int, dwell: float, spread: float = 0.0, own_seed: int = 0) -> np.ndarray:
    """Return presses held for about `dwell` samples; with a spread each is harder or softer on a unit of seed `own`."""
    rng, differs, parts, length = np.random.default_rng(seed), np.random.default_rng(own_seed), [np.zeros(20)], 20
    while length < count:
        peak, up, down = rng.uniform(0.8, 3.0), rng.integers(15, 40), rng.integers(15, 40)
        peak *= 1.0 + spread * differs.normal()
        parts += [np.linspace(0, peak, up), np.full(1 + int(rng.exponential(dwell)), peak), np.linspace(peak, 0, down)]
        parts += [np.zeros(8)]
        length += sum(map(len, parts[-4:]))
    return np.concatenate(parts)[:count]
