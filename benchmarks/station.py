"""The station on simulated rigs: contact, force limit, a host that dies, safety core, seconds of a press, time axis.

python benchmarks/station.py contact|overload|host_dies|time|seconds [--quick]
python benchmarks/station.py model [--faults N]
"""

import argparse
import itertools
import time as clock
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from common.command import Commands
from common.rig_trial import ForceLaw, RigCase, open_rig, press_until_gone
from common.station_runs import MAX_FAULTS, broken_property, explore
from common.tables import print_table
from scipy.optimize import brentq

from softcal.app.line.demo import PressTimes, RecordedLot, press_simulated_lot
from softcal.core.errors import SafetyStop, UnitRefused
from softcal.core.network.config import NetworkConfig
from softcal.core.network.training import fit_network
from softcal.core.profiles import Profile, ramps, unit_profile
from softcal.core.recording import OutputRecording
from softcal.core.simulated_lot import draw_twins
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.measured_error import MeasuredError
from softcal.core.unit.method import DecisionConfig, Method
from softcal.core.unit.scoring import score_map
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.unit_problem import UnitProblem
from softcal.station.bench.bench import open_simulated_bench
from softcal.station.clock import residual_offset_s
from softcal.station.devices.config import UNKNOWN_S
from softcal.station.motion.interlock import TABLE
from softcal.station.tasks.acquisition import RunProgress, record
from softcal.station.tasks.durations import PROBING

SEARCHING = "searching for contact"

Row = tuple[object, ...]

# How well the stage finds a unit's surface.

UNITS, TOUCHES = 12, 8
COEFFICIENTS, POWERS = (0.5, 1.2, 5.0), (1.0, 1.1, 1.25, 1.4, 1.5, 1.75, 2.0)
FIRST_APPROACH, FAST = ramps([0.3], 0.5, rest_s=0.1), ramps([1.5, 2.0], 5.0, rest_s=0.3)
LATE = ((0.1, 0.1), (0.1, UNKNOWN_S), (0.3, UNKNOWN_S))
"""How late the cell is, and what the station file says of it."""

CONTACT_HEADER = "mean, um | standard deviation, um | rms, um | largest, um | search, s"

DECISION = DecisionConfig()


def contact(options: argparse.Namespace) -> None:
    """How well the stage finds a unit's surface: error against where it truly lies, of twin units and of force laws."""
    seeds, step = range(1, 2 if options.quick else 4), 2 if options.quick else 1
    print(f"Units of the twin, {UNITS} a lot.\n")
    print_table(f"lot | {CONTACT_HEADER}", ((seed, *_statistics(_of_lot(seed))) for seed in seeds))
    print(f"Force laws k·x^p under a cell of 80 Hz with 4 mN of noise, {TOUCHES} touches each.\n")
    laws = itertools.product((1.2,) if options.quick else COEFFICIENTS, POWERS[::step])
    rows: Iterator[Row] = ((f"{k:g}", f"{p:g}", *_statistics(_of_law(ForceLaw(k, p)))) for k, p in laws)
    print_table(f"k, N/mm^p | p | {CONTACT_HEADER}", rows)
    print(f"Laws 1.2·x^p under a cell that is late, {TOUCHES} touches each; a slow press comes before the profile.\n")
    cases = itertools.product((1.4,) if options.quick else (1.0, 1.4, 2.0), LATE[::step])
    rows = (
        (
            f"{p:g}",
            f"{late_s:g}",
            _with_declared_latency(declared_s),
            *_statistics(_of_law(ForceLaw(1.2, p), late_s, declared_s, FAST)),
        )
        for p, (late_s, declared_s) in cases
    )
    print_table(f"p | late, s | stated | {CONTACT_HEADER}", rows)


def _with_declared_latency(latency_s: float) -> str:
    return "not" if latency_s == UNKNOWN_S else f"{latency_s:g}"


def _statistics(touches: list[tuple[float, float]]) -> Row:
    errors, search_s = np.array(touches).T
    rms, largest = np.sqrt(np.mean(errors**2)), np.max(np.abs(errors))
    return f"{errors.mean():+.1f}", *(f"{x:.1f}" for x in (errors.std(), rms, largest, np.mean(search_s)))


def _of_lot(seed: int) -> list[tuple[float, float]]:
    """Return the error of each contact in um, and how long its search took."""
    twins, touches = draw_twins(np.random.default_rng(seed), UNITS), []
    with open_simulated_bench(twins[0], seed) as (bench, station):
        for twin in twins:
            station.mount(twin)
            contact_recorder = _ContactRecorder()
            found_mm = record(bench, "A1", ramps([1.0], 4.0, rest_s=0.2), True, contact_recorder).contact_mm
            touches.append(
                (1e3 * (found_mm - station.rig.clearance_mm - twin.parameters.u0_mm), contact_recorder.search_s)
            )
    return touches


def _of_law(
    law: ForceLaw, late_s: float = 0.0, declared_s: float = 0.0, profile: Profile = FIRST_APPROACH
) -> list[tuple[float, float]]:
    touches = []
    for seed in range(TOUCHES):
        # The surface lies anywhere between two steps of the status.
        surface_mm = 2.2 + 0.01 * float(np.random.default_rng(seed).uniform())
        cell = {"cell_late_s": late_s, "latency_s": declared_s, "limit_N": 12.0}
        contact_recorder = _ContactRecorder()
        with open_rig(RigCase(law=law, surface_mm=surface_mm, stiffest_N_mm=60.0, seed=seed, **cell)) as (bench, _):
            error_um = 1e3 * (record(bench, "A1", profile, True, contact_recorder).contact_mm - surface_mm)
        touches.append((error_um, contact_recorder.search_s))
    return touches


class _ContactRecorder:
    """Takes the progress of a run, and keeps when it searched."""

    def __init__(self) -> None:
        self._received_s = list[float]()

    def __call__(self, progress: RunProgress) -> None:
        if progress.phase == SEARCHING:
            self._received_s.append(progress.t_s)

    @property
    def search_s(self) -> float:
        """From the beginning of the search to its end."""
        return self._received_s[-1] - self._received_s[0]


# By how much the force overshoots its limit.

LIMIT_N = 5.0
SEEDS = 3
UNITS_PRESSED = {
    "nominal unit": Twin(),
    "stiff unit": Twin(BaseParameters(k1_N_mm=6.0, k3_N_mm3=0.5)),
    "unit with a hard stop": Twin(BaseParameters(k1_N_mm=1.0, k3_N_mm3=2.0)),
}


def overload(options: argparse.Namespace) -> None:
    """Run into the force limit at several speeds: by how much does the force overshoot it?"""
    print(
        f"Force limit {LIMIT_N:g} N; load cell at 80 samples a second with delays of up to 0.1 s; worst of {SEEDS}.\n"
    )
    units = list(UNITS_PRESSED)[:1] if options.quick else UNITS_PRESSED
    speeds_mm_s = (2.0, 10.0) if options.quick else (1.0, 2.0, 5.0, 10.0)
    head = "under the stage | speed, mm/s | force rate at the limit, N/s | largest force, N | overshoot, N | stopped"
    print_table(head, itertools.starmap(_overshoot, itertools.product(units, speeds_mm_s)))


def _overshoot(name: str, speed_mm_s: float) -> Row:
    unit = UNITS_PRESSED[name]
    force_N, stopped = max(_press(unit, speed_mm_s, seed) for seed in range(SEEDS))
    k1, k3 = unit.parameters.k1_N_mm, unit.parameters.k3_N_mm3
    # Slope of F = k1·δ + k3·δ³ where F is the limit.
    depth_mm = brentq(lambda depth_mm: k1 * depth_mm + k3 * depth_mm**3 - LIMIT_N, 0.0, 10.0)
    rate_N_s = (k1 + 3 * k3 * depth_mm**2) * speed_mm_s
    return name, f"{speed_mm_s:g}", f"{rate_N_s:.0f}", f"{force_N:.2f}", f"{force_N - LIMIT_N:+.2f}", stopped


def _press(unit: Twin, speed_mm_s: float, seed: int) -> tuple[float, str]:
    with open_simulated_bench(unit, seed=seed) as (bench, station):
        config = replace(bench.config, safety=replace(bench.config.safety, force_N=LIMIT_N))
        try:
            record(replace(bench, config=config), "A1", ramps([4.0], speed_mm_s, rest_s=0.3), with_reference=False)
            stopped = "no"
        except SafetyStop:
            stopped = "yes"
        return station.rig.largest_force_N, stopped


# What still runs out when the host dies.

STOP_MM = 0.5
POSITIONS_MM = (-0.02, -0.005, -0.002, 0.0, 0.001, 0.002, 0.003)
"""Where the host dies, against the stop; deeper the force limit has stopped the stage."""


def host_dies(options: argparse.Namespace) -> None:
    """What still runs out when the host dies just above, and just in, a hard stop nobody has felt yet."""
    grid = ((10.0,), (100.0, 1000.0)) if options.quick else ((10.0, 50.0, 500.0), (20.0, 100.0, 1000.0))
    head = "mm/s² | stop, N/mm | latency stated, s | host dies | largest force, N | goal, N"
    print_table(head, _deaths(*grid))


def _deaths(accelerations: tuple[float, ...], stops_N_mm: tuple[float, ...]) -> Iterator[Row]:
    for a, stop_N_mm, latency_s in itertools.product(accelerations, stops_N_mm, (0.0, UNKNOWN_S)):
        for where, phase, stop_mm in (("in the first press", PROBING, STOP_MM), ("in the search", SEARCHING, 0.0)):
            law = ForceLaw(stop_mm=stop_mm, stop_N_mm=stop_N_mm)
            case = RigCase(a, law, 1.2, latency_s=latency_s, approach_mm=1.1)
            deaths = (press_until_gone(case, ramps([1.4], 8.0), phase, stop_mm + mm) for mm in POSITIONS_MM)
            largest_N = max(force_N for force_N in deaths if force_N is not None)
            yield f"{a:g}", f"{stop_N_mm:g}", _with_declared_latency(latency_s), where, f"{largest_N:.2f}", 18


# All runs of the safety core.


def model(options: argparse.Namespace) -> None:
    """Explore all runs of the safety core: every fault at every step, on the code that moves the real stage.

    With one fault a run, with two, and so on.
    """
    head = "faults in one run | runs | states | transitions | runs that break a property | s"
    print_table(head, map(_explored, range(options.faults + 1)))


def _explored(faults: int) -> Row:
    began_s, transitions = clock.perf_counter(), sum(len(row.exits) for row in TABLE.values())
    counterexample = explore(broken_property, faults)
    print(*counterexample.broken[:5], sep="\n", end="\n" if counterexample.broken else "")
    ways, took_s = f"{len(counterexample.ways)} of {transitions}", clock.perf_counter() - began_s
    return faults, counterexample.runs, counterexample.states, ways, len(counterexample.broken), f"{took_s:.1f}"


# How long must a unit be pressed?

SECONDS = (10.0, 15.0, 25.0, 40.0, 60.0, 90.0, 150.0)
OTHER_WORK_S = 11.0
"""Homing once, approach, zero, contact, settling and zero return; `station_soak.py` measures it."""


def seconds(options: argparse.Namespace) -> None:
    """How long must a unit be pressed? Error of its map against seconds and presses, and what a line makes per hour.

    One simulated lot is pressed over its serial lines; each unit's recording is cut to its first seconds.
    """
    units, config = (2, NetworkConfig(hidden=(32, 16))) if options.quick else (6, NetworkConfig())
    serials = [f"U{k}" for k in range(units + 1)]
    twins = draw_twins(np.random.default_rng(options.seed), units + 1)
    lot = press_simulated_lot(twins, serials, options.seed, PressTimes(300.0, max(SECONDS), 90.0))
    network = fit_network(lot.source, config).network
    source = make_source_model(lot.source, network, method=Method())
    # Errors of calibrations of the units' own, on the rows that score their maps.
    own_errors = {}
    for serial, unit in lot.units.items():
        scores = score_map(
            network, calibrate(UnitProblem(source, unit)).unit_map, lot.audits[serial], source.method.decision, config
        ).own
        own_errors[serial] = None if scores is None else scores.own
    head = "pressed, s | compressions | after/own of each unit | median | worst | passed | s per unit | units per h"
    print_table(head, (_score_press(lot, source, own_errors, pressed_s) for pressed_s in SECONDS))


def _score_press(
    lot: RecordedLot, source: SourceModel, own_errors: dict[str, MeasuredError | None], pressed_s: float
) -> Row:
    ratios, passed, presses = [], 0, []
    for serial, unit in lot.units.items():
        cut = unit.part(0, int(pressed_s * unit.sample_rate_Hz))
        presses.append(_compressions(cut))
        try:
            calibration = calibrate(UnitProblem(source, cut))
        except UnitRefused:
            ratios.append(float("nan"))
            continue
        scores = score_map(
            source.network, calibration.unit_map, lot.audits[serial], source.method.decision, own_errors[serial]
        ).own
        ratios.append(float("nan") if scores is None else scores.after_ratio)
        passed += calibration.decision.verdict == "pass"
    each, all_s = " ".join(f"{ratio:.2f}" for ratio in ratios), pressed_s + OTHER_WORK_S
    middle, worst = f"{np.nanmedian(ratios):.2f}", f"{np.nanmax(ratios):.2f}"
    counts = f"{passed} of {len(ratios)}", f"{all_s:.0f}", f"{3600 / all_s:.0f}"
    return f"{pressed_s:g}", f"{np.median(presses):.0f}", each, middle, worst, *counts


def _compressions(unit: OutputRecording) -> int:
    """Presses that begin within the recording, counted where the stage crosses a third of the depth downward."""
    stage_mm = unit.stage_mm
    level_mm = stage_mm.max() / 3
    return int(np.count_nonzero((stage_mm[:-1] < level_mm) & (stage_mm[1:] >= level_mm)))


# One time axis.

LINES = {
    "0.04 ms": (0.00004, 0.0, 0.0),
    "1 ms and 2 ms at random, stalls up to 100 ms": (0.001, 0.002, 0.1),
    "1 ms and 10 ms at random, stalls up to 100 ms": (0.001, 0.010, 0.1),
    "1 ms and 20 ms at random, stalls up to 100 ms": (0.001, 0.020, 0.1),
}
"""Least delay, mean of the random one and longest stall in s; a delay on top reaches several times its mean."""


def time(options: argparse.Namespace) -> None:
    """How well sensor, load cell and stage meet on one time axis, for lines that are late by 0.04 ms to over 100 ms.

    Recorded force and output are compared in time with those of the twin at the recorded stage position: what is left
    is the error of the alignment. Device clocks are off by a tenth of a per cent, some lines are lost or come twice,
    and the readout's millis() wraps in the middle of the run.
    """
    runs = 1 if options.quick else 5
    head = "lines come late by | median, ms | force off by, ms | output off by, ms | stage off by, mm"
    print_table(head, ((name, *_off(delays, runs)) for name, delays in LINES.items()))


def _off(delays: tuple[float, float, float], runs: int) -> Row:
    late, force, output, stage = np.max(np.abs([_run(delays, seed) for seed in range(runs)]), axis=0)
    return f"{1e3 * late:.1f}", f"{1e3 * force:.1f}", f"{1e3 * output:.1f}", f"{stage:.3f}"


def _run(delays: tuple[float, float, float], seed: int) -> tuple[float, float, float, float]:
    with open_simulated_bench(Twin(), seed) as (bench, station):
        for wire in (station.stage_wire, station.force_wire, station.readout_wire):
            wire.delay_s, wire.jitter_s, wire.stall_s = delays
        station.readout_wire.loss = station.readout_wire.repeat = 0.002
        station.readout.device_ms = 2.0**32 - 25_000
        profile = unit_profile(np.random.default_rng(seed), 30.0)
        recording = record(bench, "A1", profile, with_reference=True)
        surface_mm = recording.contact_mm - bench.config.fixture.clearance_mm - station.rig.clearance_mm
        late_s = max(recording.alignment.sensor_late_s, recording.alignment.force_late_s)
    force_N, output_V = simulate(Twin(), recording.t_s, recording.stage_mm + surface_mm)
    grid_s = np.arange(0.0, recording.t_s[-1], 1 / recording.sample_rate_Hz)
    pairs = ((force_N, recording.force_N), (output_V, recording.output[:, 0]))
    force_s, output_s = (
        residual_offset_s(np.interp(grid_s, recording.t_s, true), np.interp(grid_s, recording.t_s, estimated), 50.0)
        for true, estimated in pairs
    )
    return late_s, force_s, output_s, recording.alignment.stage_residual_mm


def main() -> None:
    every = Commands(__doc__)
    every.add(contact, "one lot, four laws")
    every.add(overload, "two speeds, one unit")
    every.add(host_dies, "one drive, two stops")
    every.add(time, "one run for each kind of line")
    every.add(seconds, "two units, a small network").add_argument("--seed", type=int, default=7, help="of the lot")
    every.add(model).add_argument("--faults", type=int, default=MAX_FAULTS, help="most in one run")
    every.run()


if __name__ == "__main__":
    main()
