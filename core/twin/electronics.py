"""Electronics: the resistance becomes a voltage, V = Vref·R/(R + Rs), with Gaussian noise and an ideal ADC."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from softcal.core.recording import Array
from softcal.core.twin.effects import Effect, Flow, Hook, Memory, Parameter, memory
from softcal.core.twin.parameters import ReadoutMetadata
from softcal.core.twin.signals import low_pass


def divide(flow: Flow, readout: ReadoutMetadata) -> None:
    """Set the output of the divider."""
    resistance = flow.resistance_ohm + flow.wiring_ohm
    flow.output_V = flow.reference_V * (resistance / (resistance + readout.r_series_ohm))


def digitise(clean_V: Array, noise_V: Array, readout: ReadoutMetadata) -> Array:
    """Return the codes of an ideal ADC in V: rounded to q = Vref/(2ⁿ − 1), clipped to [0, Vref]."""
    step_V = readout.step_V
    return np.asarray(np.clip(np.round((clean_V + noise_V) / step_V) * step_V, 0.0, readout.vref_V))


def _readout_lag(flow: Flow, values: Sequence[float], state: Memory) -> None:
    start = memory(state, "low_pass_V", flow.output_V[0], flow.output_V[0])
    flow.output_V = low_pass(flow.output_V, flow.step_s, values[0], start)


def _wiring_resistance(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.wiring_ohm = values[0]


def _reference_drift(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.reference_V = flow.reference_V * (1.0 + values[0] * flow.t_s)


def _mains_hum(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.output_V = flow.output_V + values[0] * np.sin(2 * np.pi * values[1] * flow.t_s + values[2])


def _adc_saturation(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.output_V = np.minimum(flow.output_V, values[0])


def _adc_floor(flow: Flow, values: Sequence[float], _: Memory) -> None:
    flow.output_V = np.maximum(flow.output_V, values[0])


EFFECTS = (
    Effect(
        id="readout_lag",
        stage="electronics",
        hook=Hook.OUTPUT,
        equation="V passes a first-order low-pass before the ADC",
        source="RC filter of the divider's input; 1–300 ms",
        parameters=(Parameter("tau", "s", 0.0005, 3.0, 0.08, neutral=0.0),),
        step=_readout_lag,
    ),
    Effect(
        id="wiring_resistance",
        stage="electronics",
        hook=Hook.REFERENCE,
        equation="V = Vref·(R + Rw)/(R + Rw + Rs)",
        source="leads and contacts in series with the channel, Ohm; 0.05–1 Ω",
        parameters=(Parameter("Rw", "ohm", 0.0, 50.0, 0.5, neutral=0.0),),
        step=_wiring_resistance,
    ),
    Effect(
        id="reference_drift",
        stage="electronics",
        hook=Hook.REFERENCE,
        equation="Vref(t) = Vref·(1 + ρ·t); the ADC reads against the nominal Vref",
        source="supply that warms up; linear over a run",
        parameters=(Parameter("rho", "1/s", -0.003, 0.003, 0.0001, neutral=0.0),),
        step=_reference_drift,
    ),
    Effect(
        id="mains_hum",
        stage="electronics",
        hook=Hook.OUTPUT,
        equation="V + A·sin(2πft + φ), f the alias of 50 or 60 Hz at the sample rate",
        source="pick-up of the mains; 1–10 mV",
        parameters=(
            Parameter("A", "V", 0.0, 0.5, 0.004, neutral=0.0),
            Parameter("f", "Hz", 0.0, 500.0, 10.0),
            Parameter("phi", "rad", -np.pi, np.pi, 0.0),
        ),
        step=_mains_hum,
    ),
    Effect(
        id="adc_saturation",
        stage="electronics",
        hook=Hook.OUTPUT,
        equation="V clipped above V_max < Vref",
        source="range of an amplifier or an ADC short of the rail",
        parameters=(Parameter("V_max", "V", 0.05, 100.0, 2.2, neutral=np.inf),),
        step=_adc_saturation,
    ),
)

CLIPPED_BELOW = replace(
    EFFECTS[-1],
    equation="V clipped below V_min > 0",
    parameters=(Parameter("V_min", "V", 0.0, 100.0, 0.5, neutral=0.0),),
    step=_adc_floor,
)
"""The other side of `adc_saturation`; a setting that gives `V_min` means this one."""
