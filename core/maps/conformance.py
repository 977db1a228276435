"""What every map family must keep, for the tests of families in other packages."""

import json
from collections.abc import Iterator

import numpy as np

from softcal.core.maps.interface import FitProblem, MapFamily, UnitMap, map_sha256
from softcal.core.metrics import rms
from softcal.core.network.network import Network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.windows import TAPS, windows


def faults(family: MapFamily) -> list[str]:
    """Return what a family does wrong, a line each; nothing where it conforms.

    Checked: it fits a unit that differs by gain and offset, twice with one result, and changes no input. Its map keeps
    shape and finiteness, and carries a signal as it carries its windows. It looks at no neighbouring window, and
    survives its arrays and settings. Its estimate of the unit is no worse than without any map.
    """
    problem = example_problem()
    before = problem.target.output.copy()
    fitted, again = family.fit(problem), family.fit(problem)
    try:
        json.dumps([fitted.settings(), again.settings()], allow_nan=False)
    except (TypeError, ValueError) as error:
        return [f"settings are no JSON values: {error}"]
    problems = list(_of_map(family, fitted, problem))
    if not np.array_equal(before, problem.target.output):
        problems.append("fit changes the recording it was given")
    if map_sha256(fitted) != map_sha256(again):
        problems.append("two fits of one problem give two maps; draw random numbers from problem.seed")
    if fitted.family != family.name:
        problems.append(f"the map says family {fitted.family!r}, the family is called {family.name!r}")
    return problems


def _of_map(family: MapFamily, fitted: UnitMap, problem: FitProblem) -> Iterator[str]:
    signal = problem.target.output[:200]
    probe = windows(signal)
    mapped = fitted.apply(probe.copy())
    if mapped.shape != probe.shape:
        yield f"apply turns {probe.shape} into {mapped.shape}; the same shape was expected"
        return
    if not np.all(np.isfinite(mapped)):
        yield "apply gives values that are not finite"
        return
    if not np.allclose(fitted.apply_signal(signal), mapped, rtol=0, atol=1e-9):
        yield "apply_signal(signal) is not apply(windows(signal))"
    if not np.allclose(fitted.apply(probe[::-1].copy())[::-1], mapped, rtol=0, atol=1e-9):
        yield "the map of a window depends on the windows beside it"
    rebuild_config = family.from_arrays(fitted.arrays(), json.loads(json.dumps(fitted.settings())))
    if not np.array_equal(rebuild_config.apply(probe.copy()), mapped):
        yield "from_arrays(arrays(), settings()) gives another map"
    if map_sha256(rebuild_config) != map_sha256(fitted):
        yield "the rebuilt map has another hash"
    load = problem.network.evaluate(problem.source.windows[: len(probe)])
    with_map, without = (rms(problem.network.evaluate(w) - load) for w in (mapped, probe))
    if with_map > without:
        yield f"the estimate errs by {with_map:.3g} with the map and {without:.3g} without it"


def example_problem() -> FitProblem:
    """Return a source with f that fits it exactly, and a unit of gain 1/1.3 under the same load."""
    rng = np.random.default_rng(20201900178)
    peaks = rng.uniform(1.0, 3.0, 40)
    load = np.concatenate([np.r_[np.linspace(0, p, 15), np.linspace(p, 0, 15), np.zeros(6)] for p in peaks])
    output = 0.5 + 0.1 * load + 0.02 * load**2
    t_s = np.arange(len(load)) / 50.0
    source = OutputRecording("source", t_s, output, 50.0)
    weight = np.zeros((TAPS, 1))
    weight[-1] = 1.0
    network = Network((weight,), (np.zeros(1),), 0.6, 0.1, 1.0, 1.0)
    reference = np.concatenate([np.zeros(TAPS - 1), network.evaluate(source.windows)])
    target = OutputRecording("target", t_s, (output - 0.04) / 1.3, 50.0)
    return FitProblem(LabelledRecording(source, reference), network, target)
