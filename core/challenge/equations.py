"""Equations by which a sealed rig differs from the base model, each cause at a hook of the chain.

The 25 effects of TWIN.md's catalogue in its own equations, the same causes by other equations (a
rig does not know which one it chose), and effects outside the catalogue: the honest answer to each
of those is `unknown`, with its stage.
"""

from collections.abc import Mapping

import numpy as np

from softcal.core.challenge.operators import bouc_wen, loop, low_pass, low_passes, play, power_law, prandtl_ishlinskii
from softcal.core.challenge.rig import Apply, Equation, Moment
from softcal.core.recording import Array

CATALOGUE_FORM, OUTSIDE_FORM = "catalogue", "outside"


def equations(rows: Mapping[str, tuple[str, Apply]]) -> dict[str, Equation]:
    """Return equations by their effect, from tuples of hook and function."""
    return {effect: Equation(hook, apply) for effect, (hook, apply) in rows.items()}


def in_other_forms(rows: Mapping[tuple[str, str], Apply]) -> dict[tuple[str, str], Equation]:
    """Return other equations of the catalogue's effects by (effect, form)."""
    return {(effect, form): Equation(CATALOGUE[effect].hook, apply) for (effect, form), apply in rows.items()}


def low_pass_at(signal: Array, at: Moment, tau_s: float) -> Array:
    """The memory of the catalogue: one relaxation time."""
    return low_pass(signal, at.step_s, tau_s)


def _three_times(signal: Array, at: Moment, tau_s: float) -> Array:
    """A memory of three relaxation times over a factor of 25 around τ."""
    return low_passes(signal, at.step_s, [0.4, 0.35, 0.25], [tau_s / 5.0, tau_s, 5.0 * tau_s])


def _power_law(signal: Array, at: Moment, tau_s: float) -> Array:
    """A memory by a power law: straight in log t over three decades around τ."""
    return power_law(signal, at.step_s, tau_s / 30.0, tau_s * 30.0)


def _relaxation(memory: Apply) -> Apply:
    return lambda force_N, at, share, tau_s: np.maximum(0.0, force_N - share * memory(force_N, at, tau_s))


def _creep(memory: Apply) -> Apply:
    return lambda load, at, share, tau_s: (1.0 - share) * load + share * memory(load, at, tau_s)


def _added(memory: Apply) -> Apply:
    return lambda force_N, at, share, tau_s: force_N + share * memory(force_N, at, tau_s)


def _pad_loop(loop: Apply) -> Apply:
    return lambda force_N, at, size, scale_mm: force_N * (1.0 + size * loop(at.compression_mm, scale_mm))


def _channel_loop(loop: Apply) -> Apply:
    return lambda load, at, size, scale_N: load * (1.0 + size * loop(load, scale_N))


def completed_compressions(compression_mm: Array) -> Array:
    """Return the number of compressions that ended before each point: contact and loss of contact."""
    is_pressed = compression_mm > 0.0
    released = is_pressed[:-1] & ~is_pressed[1:]
    return np.concatenate([[0.0], np.cumsum(released)])


def follows_temperature(values: Array, at: Moment, coefficient_per_K: float) -> Array:
    """Grow in proportion to the warming since the start of the run."""
    return np.asarray(values * (1.0 + coefficient_per_K * (at.temperature_C - at.temperature_C[0])))


def draw_intervals(at: Moment, count: float, mean_s: float) -> list[tuple[float, float]]:
    """Draw this run's intervals: `count` of them, exponential lengths of at least five samples."""
    end_s = float(at.t_s[-1])
    lengths_s = np.maximum(5.0 / at.rig.sample_rate_Hz, at.rng.exponential(mean_s, round(count)))
    starts_s = at.rng.uniform(0.05, 0.9, round(count)) * end_s
    return list(zip(starts_s.tolist(), (starts_s + lengths_s).tolist(), strict=True))


def _intermittent_contact(ohm: Array, at: Moment, step_ohm: float, count: float, mean_s: float) -> Array:
    is_open = np.zeros(len(ohm), dtype=bool)
    for start_s, stop_s in draw_intervals(at, count, mean_s):
        is_open |= (at.t_s >= start_s) & (at.t_s < stop_s)
    return ohm + step_ohm * is_open


def tone(volts: Array, at: Moment, amplitude_V: float | Array, frequency_Hz: float, phase: float) -> Array:
    """Add a sine."""
    return np.asarray(volts + amplitude_V * np.sin(2.0 * np.pi * frequency_Hz * at.t_s + phase))


def hum(volts: Array, at: Moment, amplitude_V: float, frequency_Hz: float) -> Array:
    """Add a sine whose phase is drawn for this run."""
    return tone(volts, at, amplitude_V, frequency_Hz, at.rng.uniform(0.0, 2.0 * np.pi))


def _dropped_samples(instants_s: Array, at: Moment, count: float) -> Array:
    """Drop `count` samples of this run in up to three blocks; the later ones close up."""
    blocks = min(3, round(count))
    sizes = at.rng.multinomial(round(count) - blocks, np.full(blocks, 1.0 / blocks)) + 1
    begins = at.rng.integers(len(instants_s) // 20, 9 * len(instants_s) // 10, blocks)
    missing = np.zeros(len(instants_s))
    for begin, size in zip(begins, sizes, strict=True):
        missing[begin:] += size
    return instants_s + missing / at.rig.sample_rate_Hz


CATALOGUE = equations(
    {
        "backlash": ("position", lambda mm, at, width_mm: play(mm, width_mm)),
        "contact_shift": ("contact", lambda mm, at, shift_mm, tau_s: mm + shift_mm * (1.0 - np.exp(-at.t_s / tau_s))),
        "frame_compliance": ("yielding", lambda mm, at, compliance_mm_per_N: mm + compliance_mm_per_N * at.force_N),
        "misaligned_contact": ("landing", lambda mm, at, length_mm: mm - length_mm * (1.0 - np.exp(-mm / length_mm))),
        "stress_relaxation": ("relaxed", _relaxation(low_pass_at)),
        "mechanical_hysteresis": ("elastic", _pad_loop(loop)),
        "mullins_softening": (
            "elastic",
            lambda force_N, at, size, cycles: (
                force_N * (1.0 - size * (1.0 - np.exp(-completed_compressions(at.compression_mm) / cycles)))
            ),
        ),
        "channel_creep": ("channel", _creep(low_pass_at)),
        "channel_hysteresis": ("channel", _channel_loop(loop)),
        "channel_collapse": (
            "resistance",
            lambda ohm, at, size_per_N2, onset_N: (
                ohm * (1.0 + size_per_N2 * np.maximum(0.0, at.force_N - onset_N) ** 2)
            ),
        ),
        "thermal_drift": ("rest_resistance", follows_temperature),
        "ageing_drift": ("rest_resistance", lambda ohm, at, size, tau_s: ohm * (1.0 + size * np.log1p(at.t_s / tau_s))),
        "intermittent_contact": ("resistance", _intermittent_contact),
        "readout_lag": ("voltage", lambda volts, at, tau_s: low_pass(volts, at.step_s, tau_s, start=float(volts[0]))),
        "wiring_resistance": ("lead", lambda ohm, at, wire_ohm: ohm + wire_ohm),
        "reference_drift": ("reference", lambda volts, at, rate_per_s: volts * (1.0 + rate_per_s * at.t_s)),
        "mains_hum": ("pickup", hum),
        "adc_saturation": ("limit", lambda volts, at, low_V, high_V: np.clip(volts, low_V, high_V)),
        "loadcell_saturation": (
            "cell",
            lambda force_N, at, saturation_N: np.asarray(saturation_N * np.tanh(force_N / saturation_N)),
        ),
        "loadcell_nonlinearity": (
            "cell",
            lambda force_N, at, size, capacity_N: force_N + size * force_N * (1.0 - force_N / capacity_N),
        ),
        "loadcell_creep": ("cell", _added(low_pass_at)),
        "loadcell_drift": ("cell", lambda force_N, at, rate_N_per_s: force_N + rate_N_per_s * at.t_s),
        "clock_offset": ("instant", lambda instants_s, at, delay_s: instants_s - delay_s),
        "clock_skew": ("instant", lambda instants_s, at, skew: instants_s * (1.0 + skew)),
        "dropped_samples": ("instant", _dropped_samples),
    }
)
"""Every effect of the catalogue by its identifier."""


def _hertzian_frame(yielding_mm: Array, at: Moment, compliance_mm_per_N: float) -> Array:
    """A frame with a joint that closes about like F^(2/3), equal to the linear one at 3 N."""
    force_N = np.maximum(0.0, at.force_N)
    return np.asarray(yielding_mm + compliance_mm_per_N * force_N * (3.05 / (force_N + 0.05)) ** (1.0 / 3.0))


def _softening_by_power(force_N: Array, at: Moment, size: float, cycles: float) -> Array:
    """Softening that grows by cycles as 1 − (1 + N/N0)^(−1.5) instead of exponentially."""
    compressions = completed_compressions(at.compression_mm)
    return force_N * (1.0 - size * (1.0 - (1.0 + compressions / cycles) ** -1.5))


def _curved_temperature(rest_ohm: Array, at: Moment, coefficient_per_K: float) -> Array:
    """A coefficient that grows by 3 % per kelvin away from the start."""
    warming_K = at.temperature_C - at.temperature_C[0]
    return np.asarray(rest_ohm * (1.0 + coefficient_per_K * warming_K * (1.0 + 0.03 * np.abs(warming_K))))


def _uneven_contact(ohm: Array, at: Moment, step_ohm: float, count: float, mean_s: float) -> Array:
    """Intervals whose steps differ by a factor of up to two."""
    added = np.zeros_like(ohm)
    for start_s, stop_s in draw_intervals(at, count, mean_s):
        added[(at.t_s >= start_s) & (at.t_s < stop_s)] = step_ohm * at.rng.uniform(0.7, 1.4)
    return ohm + added


def _second_order_lag(volts: Array, at: Moment, tau_s: float) -> Array:
    """Two equal low-passes in a row with the same total delay."""
    start = float(volts[0])
    return low_pass(low_pass(volts, at.step_s, tau_s / 2.0, start), at.step_s, tau_s / 2.0, start)


def _settling_reference(reference_V: Array, at: Moment, rate_per_s: float) -> Array:
    """A reference that settles within a minute; the catalogue's rate is its mean over 40 s."""
    drift = rate_per_s * 40.0 * (1.0 - np.exp(-at.t_s / 60.0)) / (1.0 - np.exp(-40.0 / 60.0))
    return np.asarray(reference_V * (1.0 + drift))


def _soft_clip(volts: Array, at: Moment, low_V: float, high_V: float) -> Array:
    """Return the output of an input stage that saturates smoothly over the last 15 mV before it clips."""
    knee_V = 0.015
    return np.maximum(low_V, high_V - knee_V * np.logaddexp(0.0, (high_V - volts) / knee_V))


def _bending_cell(force_N: Array, at: Moment, saturation_N: float) -> Array:
    """A cell that bends like F/(1 + (F/Fs)³)^(1/3): later and harder than tanh."""
    return force_N / (1.0 + np.abs(force_N / saturation_N) ** 3) ** (1.0 / 3.0)


def _bowed_cell(force_N: Array, at: Moment, size: float, capacity_N: float) -> Array:
    """A half sine over the cell's range instead of a parabola, with the same size."""
    return force_N + size * capacity_N / 4.0 * np.sin(np.pi * force_N / capacity_N)


def _cell_warm_up(force_N: Array, at: Moment, rate_N_per_s: float) -> Array:
    """A zero that drifts ever more slowly; the catalogue's rate is its mean over 40 s."""
    return np.asarray(force_N + rate_N_per_s * 40.0 * (1.0 - np.exp(-at.t_s / 80.0)) / (1.0 - np.exp(-40.0 / 80.0)))


def _bent_clock(instants_s: Array, at: Moment, skew: float) -> Array:
    """A rate that changes while the oscillator warms up: t² instead of t, equal after 40 s."""
    return instants_s + skew * instants_s * (0.5 + 0.5 * instants_s / 40.0)


def _beating_hum(volts: Array, at: Moment, amplitude_V: float, frequency_Hz: float) -> Array:
    """Hum whose amplitude rises and falls by 30 % over eight seconds."""
    phase, swell_phase = at.rng.uniform(0.0, 2.0 * np.pi, 2)
    swell = 1.0 + 0.3 * np.sin(2.0 * np.pi * at.t_s / 8.0 + swell_phase)
    return tone(volts, at, amplitude_V * swell, frequency_Hz, phase)


OTHER_FORMS = in_other_forms(
    {
        ("contact_shift", "square_root"): lambda mm, at, shift_mm, tau_s: (
            mm + shift_mm * np.sqrt(at.t_s / (at.t_s + tau_s))
        ),
        ("frame_compliance", "closing_joint"): _hertzian_frame,
        # δ²/(δ + ℓ), which also loses ℓ at large δ.
        ("misaligned_contact", "rounded_edge"): lambda mm, at, length_mm: mm**2 / (mm + length_mm),
        ("stress_relaxation", "three_times"): _relaxation(_three_times),
        ("stress_relaxation", "power_law"): _relaxation(_power_law),
        ("mechanical_hysteresis", "prandtl_ishlinskii"): _pad_loop(prandtl_ishlinskii),
        ("mechanical_hysteresis", "bouc_wen"): _pad_loop(bouc_wen),
        ("mullins_softening", "power_of_cycles"): _softening_by_power,
        ("channel_creep", "three_times"): _creep(_three_times),
        ("channel_creep", "power_law"): _creep(_power_law),
        ("channel_hysteresis", "prandtl_ishlinskii"): _channel_loop(prandtl_ishlinskii),
        ("channel_hysteresis", "bouc_wen"): _channel_loop(bouc_wen),
        ("channel_collapse", "hard_knee"): lambda ohm, at, size_per_N2, onset_N: (
            # A straight rise above the onset, with the catalogue's size 2 N above it.
            ohm * (1.0 + 2.0 * size_per_N2 * np.maximum(0.0, at.force_N - onset_N))
        ),
        ("thermal_drift", "curved"): _curved_temperature,
        ("ageing_drift", "square_root"): lambda ohm, at, size, tau_s: (
            ohm * (1.0 + size * (np.sqrt(1.0 + at.t_s / tau_s) - 1.0))
        ),
        ("intermittent_contact", "uneven"): _uneven_contact,
        ("readout_lag", "second_order"): _second_order_lag,
        ("reference_drift", "settling"): _settling_reference,
        ("mains_hum", "beating"): _beating_hum,
        ("adc_saturation", "soft_clip"): _soft_clip,
        ("loadcell_saturation", "bending"): _bending_cell,
        ("loadcell_nonlinearity", "half_sine"): _bowed_cell,
        ("loadcell_creep", "three_times"): _added(_three_times),
        ("loadcell_drift", "warm_up"): _cell_warm_up,
        ("clock_offset", "wandering"): lambda instants_s, at, delay_s: (
            instants_s - delay_s * (1.0 + 0.15 * np.sin(2.0 * np.pi * instants_s / 17.0))
        ),
        ("clock_skew", "warming"): _bent_clock,
    }
)
"""By (effect, form); each takes the parameters of the catalogue's and is about as large."""


def _slip(stage_mm: Array, at: Moment, jump_mm: float) -> Array:
    """The carriage loses steps once, somewhere in the middle of the run."""
    return np.asarray(stage_mm - jump_mm * (at.t_s > at.rng.uniform(0.25, 0.6) * at.t_s[-1]))


def _permanent_set(contact_mm: Array, at: Moment, share: float) -> Array:
    deepest_mm = np.maximum.accumulate(np.maximum(0.0, at.stage_mm - contact_mm))
    return contact_mm + share * deepest_mm


def _adhesion(force_N: Array, at: Moment, pull_N: float, reach_mm: float) -> Array:
    """Return the force with adhesion during unloading: −Fa·exp(−δ/d) while the surfaces touch."""
    leaving = 0.5 * (1.0 - loop(at.compression_mm, 0.02))
    touching = at.compression_mm > 0.0
    return force_N - pull_N * np.exp(-at.compression_mm / reach_mm) * leaving * touching


def _spikes(volts: Array, at: Moment, height_V: float, rate_per_s: float) -> Array:
    hit = at.rng.random(len(volts)) < rate_per_s / at.rig.sample_rate_Hz
    sign, size = at.rng.choice([-1.0, 1.0], len(volts)), at.rng.uniform(0.5, 1.0, len(volts))
    return np.asarray(volts + hit * sign * size * height_V)


def _inertia(force_N: Array, at: Moment, mass_kg: float) -> Array:
    """The platen's mass on the cell; the drive turns corners with a time constant of 15 ms."""
    smooth_mm = low_pass(low_pass(at.stage_mm, at.step_s, 0.015), at.step_s, 0.015)
    return force_N + mass_kg * 1e-3 * np.gradient(np.gradient(smooth_mm, at.step_s), at.step_s)


OUTSIDE = equations(
    {
        "slip": ("position", _slip),
        "pitch_error": (
            "position",
            lambda mm, at, amplitude_mm, pitch_mm: mm + amplitude_mm * np.sin(2.0 * np.pi * mm / pitch_mm),
        ),
        "permanent_set": ("contact", _permanent_set),
        "adhesion": ("elastic", _adhesion),
        "guide_friction": (
            # Coulomb friction of the guide that loads the pad, turned within 5 µm of a reversal.
            "elastic",
            lambda force_N, at, friction_N: (
                force_N + friction_N * loop(at.compression_mm, 0.005) * (at.compression_mm > 0.0)
            ),
        ),
        "modulus_temperature": ("elastic", follows_temperature),
        "contact_growth": (
            # Pressure F/A(F) with an area that grows by `growth`, half of it by `half_N`.
            "channel",
            lambda load, at, growth, half_N: load / (1.0 + growth * load / (load + half_N)),
        ),
        "sensitivity_ageing": ("channel", lambda load, at, rate_per_s: load * (1.0 + rate_per_s * at.t_s)),
        "divider_temperature": ("series", follows_temperature),
        "adc_inl": (
            "voltage",
            lambda volts, at, amplitude_V, period_V: (
                volts + amplitude_V * np.sin(2.0 * np.pi * (volts - volts[0]) / period_V)
            ),
        ),
        "spikes": ("pickup", _spikes),
        "cable_drag": ("cell", lambda force_N, at, drag_N_per_mm: force_N + drag_N_per_mm * at.stage_mm),
        "inertia": ("cell", _inertia),
        "cell_filter": ("cell", low_pass_at),
        "cell_hysteresis": ("cell", _channel_loop(loop)),
        "cell_span_temperature": ("cell", follows_temperature),
        "jitter": (
            "instant",
            lambda instants_s, at, spread_s: instants_s + at.rng.normal(0.0, spread_s, len(instants_s)),
        ),
    }
)
"""Every effect outside the catalogue by its name."""

ALIASES = {"divider_temperature": "thermal_drift"}
"""Effects that one of the catalogue imitates on ordinary runs: only R/Rs enters the divider."""
