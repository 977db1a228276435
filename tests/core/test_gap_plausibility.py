"""Mistakes in recordings are named before anything is fitted, and sound recordings are left alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softcal.app.files.case_folder import open_table
from softcal.core import profiles
from softcal.core.gap.case import Case, Run
from softcal.core.gap.method import METHOD
from softcal.core.gap.mistakes import suspect_units
from softcal.core.gap.twin import TWIN, diagnose
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate

READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=12, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.015)


def make_case(*effects: EffectSetting, seed: int = 1, others: dict[int, BaseParameters] | None = None) -> Case:
    rng = np.random.default_rng(seed)
    paths = (
        profiles.ramps([3.1] * 2, 0.6),
        profiles.ramps([3.1] * 6, 4.0),
        profiles.steps_with_holds([1.2, 2.4, 3.1, 1.8], hold_s=4.0),
        profiles.random_presses(rng, 20.0, 3.1),
    )
    runs = []
    for k, path in enumerate(paths):
        t_s, stage_mm = path.sample(50.0)
        base = (others or {}).get(k + 1, BASE)
        force_N, output_V = simulate(Twin(base, effects, READOUT), t_s, stage_mm, rng)
        runs.append(Run(str(k + 1), t_s, READOUT, stage_mm, force_N, output_V))
    return Case("G1", tuple(runs))


def with_mistake(case: Case, *at: int, **change: object) -> Case:
    """Change columns of some runs, all where none is named; a value is a function of the run."""
    runs = [
        replace(run, **{name: make(run) for name, make in change.items()}) if not at or k in at else run  # type: ignore[operator]
        for k, run in enumerate(case.runs, 1)
    ]
    return replace(case, runs=tuple(runs))


def scaled(channel: str, factor: float):  # type: ignore[no-untyped-def]
    return lambda run: getattr(run, channel) * factor


@pytest.fixture(scope="module")
def sound() -> Case:
    return make_case()


MISTAKES = {
    "output in mV": ((), {"output_V": scaled("output_V", 1e3)}, ("unit_factor", "output", 1e-3)),
    "output as codes": (
        (),
        {"output_V": lambda run: np.round(run.output_V / READOUT.step_V)},
        ("unit_factor", "output", READOUT.step_V),
    ),
    "one run in kgf": ((3,), {"force_N": scaled("force_N", 1 / 9.80665)}, ("unit_factor", "force", 9.80665)),
    "one run in cm": ((2,), {"stage_mm": scaled("stage_mm", 0.1)}, ("unit_factor", "stage", 10.0)),
    "stage reversed": ((), {"stage_mm": scaled("stage_mm", -1.0)}, ("sign", "stage", -1.0)),
    "stage counted downward": ((), {"stage_mm": lambda run: 40.0 - run.stage_mm}, ("sign", "stage", -1.0)),
    "force reversed in one run": ((1,), {"force_N": scaled("force_N", -1.0)}, ("sign", "force", -1.0)),
    "divider exchanged": ((), {"output_V": lambda run: 3.3 - run.output_V}, ("swapped_divider", "output", None)),
    "force and output": (
        (2,),
        {"force_N": lambda run: run.output_V, "output_V": lambda run: run.force_N},
        ("swapped_columns", "force+output", None),
    ),
    "stage and force": (
        (),
        {"stage_mm": lambda run: run.force_N, "force_N": lambda run: run.stage_mm},
        ("swapped_columns", "stage+force", None),
    ),
    "time in ms": ((), {"t_s": scaled("t_s", 1e3)}, ("unit_factor", "time", 1e-3)),
    "another rate": ((4,), {"t_s": scaled("t_s", 2.0)}, ("rate", "time", 0.5)),
    "a dropped word": (
        (2,),
        {"output_V": lambda run: np.where(np.arange(len(run)) == 77, 65.535, run.output_V)},
        ("out_of_range", "output", None),
    ),
    "a broken position": (
        (2,),
        {"stage_mm": lambda run: np.where(np.arange(len(run)) == 77, -999.0, run.stage_mm)},
        ("out_of_range", "stage", None),
    ),
    "one gain": ((3,), {"force_N": scaled("force_N", 1.05)}, ("gain", "force", 1 / 1.05)),
    "one zero": ((3,), {"force_N": lambda run: run.force_N + 0.4}, ("zero", "force", 0.4)),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_with_its_runs_and_its_repair(sound: Case, name: str) -> None:
    at, change, (what, channel, factor) = MISTAKES[name]
    diagnosis = diagnose(with_mistake(sound, *at, **change))
    assert diagnosis.verdict == "data"
    mistake = diagnosis.mistakes[0]
    assert (mistake.what, mistake.channel, mistake.runs) == (what, channel, at)
    assert mistake.factor == (None if factor is None else pytest.approx(factor, rel=0.01))
    report = diagnosis.report()
    assert report["twin"] is None and report["causes"] and not any(c["probability"] for c in report["causes"])  # type: ignore[attr-defined, union-attr]


@pytest.mark.parametrize(
    ("channel", "factor"), [("force", 9.80665), ("stage", 25.4)], ids=["force in kgf", "travel in inch"]
)
def test_a_unit_of_the_whole_case_is_asked_about_and_diagnosed(sound: Case, channel: str, factor: float) -> None:
    name = {"force": "force_N", "stage": "stage_mm"}[channel]
    diagnosis = diagnose(with_mistake(sound, **{name: scaled(name, 1 / factor)}))
    assert diagnosis.verdict == "no_gap"
    assert [(f.what, f.channel, f.runs, f.factor) for f in diagnosis.mistakes] == [("unit_factor", channel, (), factor)]
    # Force and travel are both known: the pad's stiffness is what looks odd.
    assert diagnosis.mistakes[0].evidence.code == "data.unit.stiffness"


@pytest.mark.parametrize(("newtons", "stroke"), [(30.0, 0.5), (0.03, 0.3)], ids=["200 N", "0.2 N"])
def test_an_unusual_pad_is_no_mistake(sound: Case, newtons: float, stroke: float) -> None:
    pad = with_mistake(sound, force_N=scaled("force_N", newtons), stage_mm=scaled("stage_mm", stroke))
    assert TWIN.mistakes(pad) == () and diagnose(pad).verdict == "no_gap"


@pytest.mark.parametrize("seed", range(120, 128))
def test_lost_samples_are_no_wrong_unit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    losses = sorted((float(rng.uniform(3.0, 15.0)), int(rng.integers(3, 20))) for _ in range(3))
    assert TWIN.mistakes(make_case(EffectSetting("dropped_samples", {}, tuple(losses)), seed=seed)) == ()


@pytest.mark.parametrize(("ratio", "what"), [(1 / 4.44822, "unit_factor"), (1 / 3.15, "gain")])
def test_a_unit_is_suggested_only_where_the_number_fits(sound: Case, ratio: float, what: str) -> None:
    mistakes = TWIN.mistakes(with_mistake(sound, 2, force_N=scaled("force_N", ratio)))
    assert [(f.what, f.runs) for f in mistakes] == [(what, (2,))]
    assert mistakes[0].factor == pytest.approx(1 / ratio, rel=0.1)


@pytest.mark.parametrize("effect", ["mullins_softening", "readout_lag", "thermal_drift", "clock_skew"])
def test_an_effect_is_no_mistake(effect: str) -> None:
    diagnosis = diagnose(make_case(EffectSetting(effect)))
    assert diagnosis.mistakes == () and diagnosis.verdict != "data"


def test_a_run_of_another_unit_is_distinguished() -> None:
    other = BASE.with_values(k1_N_mm=1.25, r0_ohm=4.5, kappa_per_N=0.054, u0_mm=0.45)
    mistakes = diagnose(make_case(others={2: other})).mistakes
    assert [(f.what, f.runs) for f in mistakes] == [("other_unit", (2,))]


def test_two_runs_paired_wrongly_are_named(sound: Case) -> None:
    one, other = sound.runs[0], sound.runs[2]
    count = min(len(one), len(other))
    short = [
        replace(run, **{name: getattr(run, name)[:count] for name in ("t_s", "stage_mm", "force_N", "output_V")})
        for run in (one, other)
    ]
    swapped = (replace(short[0], force_N=short[1].force_N), replace(short[1], force_N=short[0].force_N))
    mistakes = TWIN.mistakes(replace(sound, runs=(swapped[0], sound.runs[1], swapped[1], sound.runs[3])))
    assert [(f.what, f.channel, f.runs) for f in mistakes] == [("swapped_runs", "force", (1, 3))]


def test_a_gain_of_all_runs_shows_where_the_lot_states_its_stiffness(sound: Case) -> None:
    # Peak force over depth beyond contact: k1 + k3·δ² at δ = 2.75 mm.
    stiffness_N_mm = 1.1 + 0.1 * 2.75**2
    stiffness_range = (0.93 * stiffness_N_mm, 1.07 * stiffness_N_mm)
    heavier = with_mistake(sound, force_N=scaled("force_N", 1.15))
    assert TWIN.mistakes(replace(sound, stiffness_N_mm=stiffness_range)) == ()
    assert TWIN.mistakes(heavier) == ()
    assert [(f.what, f.channel) for f in TWIN.mistakes(replace(heavier, stiffness_N_mm=stiffness_range))] == [
        ("gain", "force")
    ]


def test_a_stiff_pad_that_the_lot_states_is_believed(sound: Case) -> None:
    stiff = with_mistake(sound, stage_mm=scaled("stage_mm", 1 / 25.4))
    assert TWIN.mistakes(replace(stiff, stiffness_N_mm=(1.0, 3.0)))[0].what == "unit_factor"
    assert suspect_units(stiff, METHOD.mistake)[0].what == "unit_factor"
    believed = replace(stiff, stiffness_N_mm=(40.0, 60.0))
    assert TWIN.mistakes(believed) == suspect_units(believed, METHOD.mistake) == ()


@pytest.mark.parametrize("name", ["S1", "S2"])
def test_real_recordings_hold_no_mistake(name: str, measured_data: Path) -> None:
    path = measured_data / "egain_pair" / f"{name}.csv"
    assert TWIN.mistakes(open_table(path, ReadoutMetadata(5.0, 10, 1.0, 50.0))) == ()
