"""A problem of `mujoco.sysid` is diagnosed as it stands, and what both fit agrees within both intervals."""

import importlib.util
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.app.gap.mujoco_sysid import from_sysid
from softcal.core.errors import InputError
from softcal.core.gap.simulator_model import diagnose_simulator

EXAMPLES = Path(__file__).parents[2] / "examples" / "simulators"


@pytest.fixture(scope="module")
def slide(require: Any) -> Any:
    sysid = importlib.import_module("mujoco.sysid") if importlib.util.find_spec("mujoco") else None
    require(hasattr(sysid, "optimize"), "mujoco.sysid or its extra packages are missing: pip install 'mujoco[sysid]'")
    sys.path.insert(0, str(EXAMPLES))
    try:
        import mujoco_slide
    finally:
        sys.path.remove(str(EXAMPLES))
    return mujoco_slide


@pytest.mark.long
@pytest.mark.parametrize("friction_N", [0.0, 0.4])
def test_its_parameters_with_a_neutral_value_are_the_candidates(slide: Any, friction_N: float) -> None:
    problem = slide.problem(friction_N)
    diagnosis = diagnose_simulator(problem.simulator, problem.runs)
    likely = {c.effect for c in diagnosis.causes if c.probability > 0.5}
    assert (diagnosis.verdict, likely) == (("explained", {"dry_friction_N"}) if friction_N else ("no_gap", set()))
    if friction_N:
        (cause,) = (c.parameters["change"] for c in diagnosis.causes if c.effect == "dry_friction_N")
        assert cause.low < friction_N < cause.high


@pytest.mark.long
def test_what_both_fit_agrees_within_both_intervals(slide: Any, capsys: pytest.CaptureFixture[str]) -> None:
    sysid, runs = slide.sysid, slide.sequences(0.4)
    params = slide.parameters()
    for name in ("rotor_kg", "motor"):
        params[name].frozen = True
    residual = sysid.build_residual_fn(models_sequences=runs, n_threads=1)
    began = time.process_time()
    fitted, result = sysid.optimize(params.copy(), residual, verbose=False)
    theirs_s, began = time.process_time() - began, time.process_time()
    problem = from_sysid(params, runs, {"dry_friction_N": 0.0})
    diagnosis = diagnose_simulator(problem.simulator, problem.runs)
    ours_s = time.process_time() - began
    at_best, _, _ = residual(fitted.as_vector(), fitted.copy())
    _, half = sysid.calculate_intervals([np.concatenate([r.ravel() for r in at_best])], result.jac, alpha=0.10)
    values = diagnosis.model.simulator.parameter_values(diagnosis.best.hypothesis, diagnosis.best.coordinates)
    names = [p.name for p in diagnosis.best.hypothesis.parameters]
    spread = dict(zip(names, np.sqrt(np.diag(diagnosis.best.covariance)), strict=True))
    ours = {name: values.get(name, values.get(f"{name}.change")) for name in ("mass_kg", "damping", "dry_friction_N")}
    wide = {
        "mass_kg": 1.645 * spread["mass_kg"],
        "damping": 1.645 * spread["damping"] * values["damping"],
        "dry_friction_N": 1.645 * spread["change"],
    }
    with capsys.disabled():
        print(f"\nmujoco.sysid {theirs_s:.1f} s of CPU (fit alone), softcal {ours_s:.1f} s (diagnosis)")
        for k, name in enumerate(ours):
            their = float(fitted[name].value[0])
            print(f"{name:<16} {their:.4f} ± {half[k]:.4f}   {ours[name]:.4f} ± {wide[name]:.4f}")
    for k, name in enumerate(ours):
        apart = abs(float(fitted[name].value[0]) - ours[name])
        assert apart < half[k] + wide[name]


@pytest.mark.long
def test_what_it_cannot_take_is_refused_in_one_line(slide: Any) -> None:
    sysid, runs, params = slide.sysid, slide.sequences(0.0), slide.parameters()
    with pytest.raises(InputError, match="no_such"):
        from_sysid(params, runs, {"no_such": 0.0})
    with pytest.raises(InputError, match="no measured sequence"):
        from_sysid(params, [], slide.NEUTRAL)
    transform = sysid.SignalTransform()
    transform.gain("*", params["motor"], target="both")
    with pytest.raises(InputError, match="target='predicted'"):
        from_sysid(params, runs, slide.NEUTRAL, transform)


def test_without_its_extra_the_line_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'mujoco\[sysid\]'"):
        from_sysid(None, [], {})
