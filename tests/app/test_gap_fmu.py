"""A functional mock-up unit that is compiled from C: its calls, and its diagnosis against a rig of SciPy."""

import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from softcal.app.gap.adapters import run_fmu
from softcal.core.gap.simulator import Simulator, candidate, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter

VARIABLES = ("k", "d", "rub", "f", "x")
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="cart" guid="{{cart}}">
<CoSimulation modelIdentifier="cart" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs><Unknown index="5"/></Outputs></ModelStructure></fmiModelDescription>"""
START = '><Real start="0"/></ScalarVariable>'
PARAMETER = 'causality="parameter" variability="tunable"' + START
KINDS = {"f": 'causality="input"' + START, "x": 'causality="output"><Real/></ScalarVariable>'}
UNIT = """
#include <math.h>
#include <stdlib.h>
#include "fmi2Functions.h"
typedef struct { double v[5], speed; } Cart;
const char* fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char* fmi2GetVersion(void) { return fmi2Version; }
fmi2Component fmi2Instantiate(fmi2String n, fmi2Type t, fmi2String g, fmi2String r, const fmi2CallbackFunctions* c,
                              fmi2Boolean v, fmi2Boolean l) { return calloc(1, sizeof(Cart)); }
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real t, fmi2Real s, fmi2Boolean sd, fmi2Real e)
{ return fmi2OK; }
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean l, size_t n, const fmi2String s[]) { return fmi2OK; }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real out[])
{ for (size_t i = 0; i < n; i++) out[i] = ((Cart*)c)->v[r[i]]; return fmi2OK; }
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real in[])
{ for (size_t i = 0; i < n; i++) ((Cart*)c)->v[r[i]] = in[i]; return fmi2OK; }
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep)
{ Cart* s = c; int n = 40; h /= n;
  for (int i = 0; i < n; i++) {
    double a = s->v[3] - s->v[0] * s->v[4] - s->v[1] * s->speed - s->v[2] * tanh(s->speed / 0.02);
    s->v[4] += h * s->speed + 0.5 * h * h * a; s->speed += h * a; }
  return fmi2OK; }
"""
UNUSED = """
GetInteger SetInteger GetBoolean SetBoolean GetString SetString GetFMUstate SetFMUstate FreeFMUstate
SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative SetRealInputDerivatives
GetRealOutputDerivatives CancelStep GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
"""
"""Functions of the standard that every unit must have."""


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`cart.fmu`: a mass of 1 kg on a spring that rubs, stepped forty times a sample."""
    fmpy = pytest.importorskip("fmpy", reason="pip install 'softcal[fmu]'")
    folder = tmp_path_factory.mktemp("unit")
    (folder / "cart.c").write_text(UNIT)
    (folder / "unused.c").write_text("".join(f"int fmi2{name}() {{ return 3; }}\n" for name in UNUSED.split()))
    headers = Path(fmpy.__file__).parent / "c-code"
    sources = [str(folder / name) for name in ("cart.c", "unused.c")]
    command = ["gcc", "-shared", "-fPIC", "-O2", f"-I{headers}", *sources, "-o", str(folder / "cart.so"), "-lm"]
    subprocess.run(command, check=True)
    rows = [
        f'<ScalarVariable name="{name}" valueReference="{k}" {KINDS.get(name, PARAMETER)}'
        for k, name in enumerate(VARIABLES)
    ]
    with zipfile.ZipFile(folder / "cart.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.format(variables="".join(rows)))
        archive.write(folder / "cart.so", "binaries/linux64/cart.so")
    return folder / "cart.fmu"


def test_a_unit_of_c_is_diagnosed_against_a_rig_of_another_integrator(unit: Path) -> None:
    run = run_fmu(unit, {"place_m": "x"}, {"push_N": "f"}, {"stiffness": "k", "damping": "d", "friction.size": "rub"})
    cart = Simulator(
        "cart",
        run,
        ("push_N",),
        ("place_m",),
        (Parameter("stiffness", "N/m", 1.0, 100.0, 10.0), Parameter("damping", "N·s/m", 0.0, 5.0, 0.5)),
        (candidate("friction", "rail", Parameter("size", "N", 0.0, 2.0, 0.1, neutral=0.0)),),
    )
    rng, runs, t_s = np.random.default_rng(6), [], np.arange(0.0, 6.0, 0.02)
    for k in (1, 2):
        push_N = 2.0 * np.sin((0.8 + 0.9 * k) * t_s)

        def rates(t: float, y: Any, push_N: Any = push_N) -> list[float]:
            # A unit holds its input over a step.
            force = push_N[min(int(t / 0.02 + 1e-9), len(push_N) - 1)]
            return [y[1], force - 8.0 * y[0] - 0.4 * y[1] - 0.3 * np.tanh(y[1] / 0.02)]

        clean = solve_ivp(rates, (0.0, t_s[-1]), [0.0, 0.0], t_eval=t_s, max_step=0.01, rtol=1e-7).y[0]
        columns = {"t_s": t_s, "push_N": push_N, "place_m": clean + rng.normal(0.0, 0.002, len(t_s))}
        runs.append(recorded(cart, str(k), columns))
    diagnosis = diagnose_simulator(cart, runs)
    assert (diagnosis.verdict, diagnosis.best.ids) == ("explained", ("friction",))
    parameters = diagnosis.report()["parameters"]
    assert parameters["friction.size"] == pytest.approx(0.3, rel=0.05)
    assert parameters["stiffness"] == pytest.approx(8.0, rel=0.02)
