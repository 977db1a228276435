"""Lots whose truth is outside what the method was set on, and measured lots: fitted once, kept for `trust.py`."""

import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from common.map_methods import egain, insole, skin, taxel, taxels
from common.planted import LineEffects, planted
from common.simulated_cases import NETWORK
from numpy.typing import NDArray

from softcal.core.challenge.case_generator import draw_case
from softcal.core.challenge.cases import press_lot
from softcal.core.challenge.rig import Measured
from softcal.core.errors import InputError, UnitRefused
from softcal.core.maps.interface import Anchors
from softcal.core.metrics import rmse
from softcal.core.network.training import fit_network
from softcal.core.profiles import Profile, moves, random_presses, source_profile, unit_profile
from softcal.core.quality.interval_inflation import AuditedSamples
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.simulated_lot import DEPTH_MM, LotDesign, draw_twins, simulate_lot
from softcal.core.twin.simulate import Twin, simulate
from softcal.core.unit.calibrate import calibrate
from softcal.core.unit.day_correction import fit_day_correction
from softcal.core.unit.estimate import Estimate, estimate
from softcal.core.unit.evidence import rms_load
from softcal.core.unit.lot_correction import AuditedLine
from softcal.core.unit.method import Method
from softcal.core.unit.output_level import OutputLevel, load_line
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.core.unit.state import UnitState
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.unit_problem import UnitProblem
from softcal.core.unit.verdict import Limit, default_limit

UNITS, MANY, MANY_EVERY, LARGE = 14, 26, 6, 30
"""Units of a lot; every sixth seed has lots large enough for twenty audits; units of a lot of `power_lots`."""

SPREAD, DAY = LineEffects(load_spread=0.12), LineEffects(day_gain=0.08, day_zero=0.03)
OWN_PROGRAMME = "own programme"
ROWS_KEPT = 240
"""Instants of an audit that are kept with a fit."""


@dataclass(frozen=True)
class FittedUnit:
    """One unit of a lot: what was said of it without a label, and the truth.

    Args:
        kind, lot, serial: where it is from.
        forecast, upper: forecast RMSE and the upper end of its 95 % interval; infinite for a refused unit.
        truth: RMSE against the labels of the audit.
        limit: of its lot.
        word: what the forecast and the findings say without any audit.
        is_vetoed: whether a finding allows no better word than fail or retest, whatever its forecast.
        knowledge: how its loads were known.
        load: RMS load above rest that its recording shows, in the reference unit.
        rest, span: of the output of its recording; 0 of a refused unit.
        sample: (3, n) estimate, reference and half-width at evenly spaced instants of the audit; empty if refused.
    """

    kind: str
    lot: str
    serial: str
    forecast: float
    upper: float
    truth: float
    limit: float
    word: str
    is_vetoed: bool
    knowledge: str = ""
    load: float = 0.0
    rest: float = 0.0
    span: float = 0.0
    sample: tuple[tuple[float, ...], ...] = ()

    @property
    def line(self) -> AuditedLine:
        """How it reads the loads of its audit."""
        return AuditedLine(load_line(*np.array(self.sample)[:2]), self.level)

    @property
    def level(self) -> OutputLevel:
        """Where the output of its recording stands."""
        return OutputLevel(self.rest, self.span)

    @property
    def samples(self) -> AuditedSamples:
        """What an audit of it shows of its interval; empty for a refused unit."""
        estimate, reference, half = np.array(self.sample) if self.sample else np.empty((3, 0))
        return AuditedSamples(np.abs(estimate - reference), half)


@dataclass(frozen=True, eq=False)
class RawUnit:
    """A unit before anything was fitted: what the line recorded, and the labelled recording that holds the truth."""

    recording: OutputRecording
    audit: LabelledRecording
    anchors: Anchors | None = None


@dataclass(frozen=True, eq=False)
class RawLot:
    """A source and the units made with it; `golden` is the source pressed again in their sitting."""

    kind: str
    name: str
    source: LabelledRecording
    units: tuple[RawUnit, ...]
    golden: LabelledRecording | OutputRecording | None = None


def designs(units: int) -> dict[str, LotDesign]:
    """Return the kinds of lot on the twin, by name."""
    bad = planted(("extra creep", "other sensor", "saturated"))
    return {
        "in step": LotDesign(units),
        "own programme": LotDesign(units, shift=OWN_PROGRAMME),
        "stage known, own programme": LotDesign(units, shift=OWN_PROGRAMME, has_stage=True),
        "planted bad units": LotDesign(units - 3, bad),
        "load spread 12 %, in step": LotDesign(units, line=SPREAD),
        "load spread 12 %, own programme": LotDesign(units, shift=OWN_PROGRAMME, line=SPREAD),
        "load spread 12 %, stage known": LotDesign(units, shift=OWN_PROGRAMME, has_stage=True, line=SPREAD),
        "another day, in step": LotDesign(units, line=DAY),
        "another day, own programme": LotDesign(units, shift=OWN_PROGRAMME, line=DAY),
        "below half the range": LotDesign(units, shift="below half"),
    }


SEALED = {"twin's effects": "pair", "effects of other form": "form", "effects outside the catalogue": "outside"}
"""Lots on sealed rigs: the challenge's own simulator, not the twin the method was set on."""

GOOD = ("in step", "stage known, own programme", "planted bad units")
"""Kinds of lot whose good units ought to be released."""


def drawn_lots(seed: int) -> Iterator[RawLot]:
    """Yield one lot of every drawn kind. Those on the twin share a source, so that one network serves them."""
    count = MANY if seed % MANY_EVERY == MANY_EVERY - 1 else UNITS
    for kind, design in designs(count).items():
        lot = simulate_lot(seed, design)
        yield RawLot(kind, f"{kind} {seed}", lot.source, tuple(RawUnit(u.recording, u.audit) for u in lot.units))
    for kind, line in SEALED.items():
        runs = list(press_lot(draw_case(seed, "lot", line), count))
        units, audits = ([_labelled(r.serial, r.measured) for r in runs if r.folder == p] for p in ("units", "audit"))
        source = next(_labelled(r.serial, r.measured) for r in runs if r.folder == "source")
        pairs = zip(units, audits, strict=True)
        yield RawLot(kind, f"{kind} {seed}", source, tuple(RawUnit(u.unlabelled, a) for u, a in pairs))


def _labelled(serial: str, measured: Measured) -> LabelledRecording:
    columns = measured.columns
    t_s = columns["t_s"]
    rate_Hz = 1 / float(np.median(np.diff(t_s)))
    return LabelledRecording(OutputRecording(serial, t_s, columns["output_V"], rate_Hz), columns["force_N"])


def day_lots(seed: int) -> Iterator[RawLot]:
    """Yield lots read on another day, in step with the source: without a golden run, and with one."""
    lot = simulate_lot(seed, LotDesign(UNITS, line=DAY))
    units = tuple(RawUnit(u.recording, u.audit) for u in lot.units)
    for kind, golden in (
        ("another day", None),
        ("another day, golden run", lot.golden.unlabelled),
        ("another day, golden run under the load cell", lot.golden),
    ):
        yield RawLot(kind, f"{kind} {seed}", lot.source, units, golden)


@dataclass(frozen=True)
class Readout:
    """Gain and zero of a day, about the rest of the source's output."""

    rest_V: float
    gain: float = 1.0
    zero_V: float = 0.0

    def __call__(self, output: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.rest_V + self.gain * (output - self.rest_V) + self.zero_V


def power_lots(seed: int) -> Iterator[RawLot]:
    """Yield lots whose audits or known loads show what no unlabelled recording does; all share a source.

    The audits are on the source's day but in the lots that say otherwise. A known load is a weight at rest, read where
    the unit is used: on the day of the audits.
    """
    rng = np.random.default_rng([seed, 60_013])
    twins = draw_twins(rng, LARGE + 1)
    source = _press(rng, twins[0], source_profile(rng, 170.0), "S0")
    low, high = np.quantile(source.unlabelled.output, (0.02, 0.98))
    same = Readout(low)
    day = Readout(low, 1 + DAY.day_gain * rng.normal(), DAY.day_zero * (high - low) * rng.normal())
    shared = unit_profile(rng, 60.0)
    golden = _press(rng, twins[0], shared, "S0", day)
    audits, later = list[LabelledRecording](), list[LabelledRecording]()
    in_step, next_day, other, spread, spread_own = (list[OutputRecording]() for _ in range(5))
    loads = list[Anchors]()
    for number, twin in enumerate(twins[1:], start=1):
        serial = f"U{number:03d}"
        harder = _harder(twin, 1 + SPREAD.load_spread * float(np.clip(rng.normal(), -2.0, 2.0)))
        own_presses = random_presses(rng, 60.0, DEPTH_MM)
        audits.append(_press(rng, twin, source_profile(rng, 120.0), serial))
        later.append(_press(rng, twin, random_presses(rng, 120.0, DEPTH_MM), serial, day))
        in_step.append(_press(rng, twin, source_profile(rng, 60.0), serial).unlabelled)
        next_day.append(replace(in_step[-1], output=day(in_step[-1].output)))
        other.append(_press(rng, twin, shared, serial, day).unlabelled)
        spread.append(_press(rng, harder, source_profile(rng, 60.0), serial).unlabelled)
        spread_own.append(_press(rng, harder, own_presses, serial).unlabelled)
        loads.append(_weights(rng, twin, same))
    none = [None] * LARGE
    for kind, recordings, truths, anchors, run in (
        ("audits the next day, another programme", in_step, later, none, None),
        ("units the next day", next_day, audits, none, None),
        ("units the next day, another programme", other, audits, none, None),
        ("units the next day, another programme, golden run", other, audits, none, golden.unlabelled),
        ("units the next day, another programme, golden run under the load cell", other, audits, none, golden),
        ("units the next day, another programme, two known loads", other, audits, loads, None),
        ("press spread 12 %", spread, audits, none, None),
        ("press spread 12 %, two known loads", spread, audits, loads, None),
        ("press spread 12 %, programmes of their own, two known loads", spread_own, audits, loads, None),
    ):
        units = tuple(map(RawUnit, recordings, truths, anchors))
        yield RawLot(kind, f"power {kind} {seed}", source, units, run)


def _press(
    rng: np.random.Generator, twin: Twin, profile: Profile, serial: str, readout: Readout | None = None
) -> LabelledRecording:
    rate_Hz = twin.metadata.sample_rate_Hz
    t_s, stage_mm = profile.sample(rate_Hz)
    force_N, output_V = simulate(twin, t_s, stage_mm, rng)
    shown_V = output_V if readout is None else readout(output_V)
    return LabelledRecording(OutputRecording(serial, t_s, shown_V, rate_Hz), force_N)


def _harder(twin: Twin, factor: float) -> Twin:
    base = twin.parameters
    return replace(twin, parameters=replace(base, k1_N_mm=factor * base.k1_N_mm, k3_N_mm3=factor * base.k3_N_mm3))


def _weights(rng: np.random.Generator, twin: Twin, readout: Readout) -> Anchors:
    """Read a unit at rest with nothing on it, and under a weight of two thirds of its load at full depth."""
    depth_mm, hold_s = 0.85 * DEPTH_MM, 3.0
    weight_holds = moves("weights", [0.0, depth_mm], [1.0, 1.0], [hold_s, hold_s])
    run = _press(rng, twin, weight_holds, "weights", readout)
    count = int(0.5 * run.unlabelled.sample_rate_Hz)
    first = int((hold_s - 0.6) * run.unlabelled.sample_rate_Hz)
    rows = (slice(first, first + count), slice(len(run) - count, len(run)))
    return Anchors(
        *(np.array([values[part].mean() for part in rows]) for values in (run.unlabelled.output, run.reference))
    )


def measured_lots(sources: int = 3) -> Iterator[RawLot]:
    """Yield the recordings of shared/data as lots: taxels by source and programme, places of the skin, the pair.

    Every third taxel is a unit.
    """
    day, other = insole("calibration"), insole("validation_1")
    names = taxels(day)
    half = np.arange(len(day)) * 32 // len(day) % 2 == 0
    for source in names[:: max(len(names) // sources, 1)][:sources]:
        rest = [n for n in names[1::3] if n != source]
        same = tuple(RawUnit(taxel(day, n, half).unlabelled, taxel(day, n, ~half)) for n in rest)
        later = tuple(RawUnit(taxel(other, n).unlabelled, unit.audit) for n, unit in zip(rest, same, strict=True))
        for kind, units in (("insole, same programme", same), ("insole, other day and programme", later)):
            yield RawLot(kind, f"{kind} {source}", taxel(day, source, half), units)
    positions = {name: skin(name) for name in ("left", "middle", "right")}
    yield from _in_turn("skin, three places", positions)
    pair = {name: egain(name) for name in ("S1", "S2")}
    yield from _in_turn("egain pair", pair)


def _in_turn(kind: str, recordings: Mapping[str, LabelledRecording]) -> Iterator[RawLot]:
    """Yield a lot per unit as the source of the others; fitted on the first two thirds, tested on the rest."""
    for source, labelled in recordings.items():
        units = tuple(
            RawUnit(_part(r, 0, 2 / 3).unlabelled, _part(r, 2 / 3, 1)) for n, r in recordings.items() if n != source
        )
        yield RawLot(kind, f"{kind} {source}", _part(labelled, 0, 2 / 3), units)


def _part(recording: LabelledRecording, start: float, stop: float) -> LabelledRecording:
    return recording.part(int(start * len(recording)), int(stop * len(recording)))


def fitted(lots: Callable[[], Iterator[RawLot]], name: str, cache: Path) -> list[FittedUnit]:
    """Return the units of lots, fitted now or read from the cache: a folder of this name, a file a lot.

    What was cut off goes on with the first lot that is missing.
    """
    folder, models, names = cache / name, dict[str, SourceModel](), list[str]()
    whole = folder / "whole"
    if whole.exists():
        return [unit for file in whole.read_text().splitlines() for unit in _read(folder / file)]
    folder.mkdir(parents=True, exist_ok=True)
    for lot in lots():
        names.append(re.sub(r"\W+", "-", lot.name) + ".jsonl")
        file = folder / names[-1]
        if not file.exists():
            rows = [json.dumps(asdict(unit)) + "\n" for unit in _fit_lot(lot, models)]
            part = file.with_suffix(".part")
            part.write_text("".join(rows))
            part.rename(file)
    whole.write_text("\n".join(names))
    return fitted(lots, name, cache)


def _read(file: Path) -> list[FittedUnit]:
    return [FittedUnit(**json.loads(line)) for line in file.read_text().splitlines()]


def _fit_lot(lot: RawLot, models: dict[str, SourceModel]) -> Iterator[FittedUnit]:
    if lot.source.sha256 not in models:
        trained = fit_network(lot.source, NETWORK)
        models[lot.source.sha256] = make_source_model(
            lot.source, trained.network, trained.validation_rows, method=Method()
        )
    model = models[lot.source.sha256]
    day_correction = None if lot.golden is None else fit_day_correction(model, lot.golden)
    for unit in lot.units:
        limit = default_limit(lot.source.reference_unit, model.held_out_rmse, model.full_range, model.method.decision)
        agreed = Limit(limit.unit, limit.maximum_rmse)
        problem = UnitProblem(model, unit.recording, agreed, anchors=unit.anchors, day_correction=day_correction)
        yield _fit_unit(lot, problem, unit.audit)


def _fit_unit(lot: RawLot, problem: UnitProblem, audit: LabelledRecording) -> FittedUnit:
    model, recording = problem.source, problem.recording
    limit = default_limit(
        lot.source.reference_unit, model.held_out_rmse, model.full_range, model.method.decision
    ).maximum_rmse
    serial = recording.serial
    try:
        calibration = calibrate(problem)
        result = estimate(model.network, calibration, audit.unlabelled)
    except (UnitRefused, InputError):
        return FittedUnit(lot.kind, lot.name, serial, float("inf"), float("inf"), float("inf"), limit, "fail", True)
    forecast, predicted = calibration.forecast, calibration.decision.predicted
    rows = np.isfinite(result.estimate)
    is_vetoed = not calibration.fit.is_open
    return FittedUnit(
        lot.kind,
        lot.name,
        serial,
        forecast.rmse,
        forecast.upper,
        rmse(result.estimate[rows], audit.reference[rows]),
        limit,
        str(predicted.verdict),
        is_vetoed,
        str(calibration.correspondence),
        _load(model, calibration, recording),
        calibration.fit.output_level.rest,
        calibration.fit.output_level.span,
        _sample(result, audit, rows),
    )


def _load(model: SourceModel, calibration: UnitState, recording: OutputRecording) -> float:
    spread = np.linspace(0, len(recording.windows) - 1, 2 * model.method.map.pairs.pairs).astype(np.int64)
    load = model.network.evaluate(calibration.unit_map.apply(recording.windows[np.unique(spread)]))
    return rms_load(model, load)


def _sample(result: Estimate, audit: LabelledRecording, rows: NDArray[np.bool_]) -> tuple[tuple[float, ...], ...]:
    at = np.flatnonzero(rows)
    at = at[np.linspace(0, len(at) - 1, ROWS_KEPT).astype(np.int64)]
    half = np.maximum(result.upper - result.estimate, 1e-12)
    columns = (result.estimate[at], audit.reference[at], half[at])
    return tuple(tuple(float(f"{value:.5g}") for value in column) for column in columns)


def covered(unit: FittedUnit, inflation: IntervalInflation = IntervalInflation()) -> float:  # noqa: B008 - frozen
    """Return the share of the unit's samples within its interval, widened."""
    return float(np.mean(unit.samples.ratio(inflation) <= 1))
