"""What softcal says: a code with typed values. English stands in core, other languages in app/texts.

The sentences on units and verdicts stand here, those of stations, their gates and the registry in `rig_sentences`,
those of a diagnosis in `gap_sentences`.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from string import Formatter
from typing import Any, Union

from softcal.core.words.gap_sentences import GAP_SENTENCES
from softcal.core.words.rig_sentences import SENTENCES

Value = Union[str, float, int, "Reason"]

DOUBT = "doubt."
"""How the codes of reasons begin that set an audit aside."""

PLAIN = "plain"
"""Code of a sentence that was kept as a sentence: by an older version, or quoted from a file or device."""

ENGLISH: Mapping[str, str] = {
    PLAIN: "{text}",
    # The statement on an error, forecast or measured.
    "statement": (
        "{source} RMSE {rmse:.3g} {unit} (95 %: {lower:.3g} to {upper:.3g}) is {relation} the limit {limit:.3g} {unit} "
        "({origin})"
    ),
    "part.predicted": "predicted",
    "part.measured": "measured",
    "part.within": "within",
    "part.within_close": "within, but closer than its uncertainty to",
    "part.above": "above",
    "part.above_close": "above, but closer than its uncertainty to",
    "part.stated": "stated for the lot",
    "part.automatic": "no limit was stated: {factor:g} x the source's own held-out RMSE of {rmse:.3g} {unit}",
    "reference_missing": (
        "reference {cell} has no certificate that states its uncertainty: nothing is traced to it and no unit passes; "
        "state the certificate and run again"
    ),
    "reference_expired": (
        "certificate {number} of reference {cell} holds from {issued_on} until {due_on}; the source was recorded on "
        "{used_on}: nothing is traced to it and no unit passes"
    ),
    "reference_range": (
        "certificate {number} covers the reference up to {capacity:.4g}, the source was pressed to {highest:.4g}: no "
        "unit passes"
    ),
    "reference_uncertain": (
        "the reference's own uncertainty U_ref = {expanded:.3g} {unit} (k = 2) leaves no room to pass"
    ),
    "harmful": "worse than doing nothing: RMSE {after:.3g} {unit} with the map, {before:.3g} {unit} without it",
    "stale_limit": (
        "judged against {judged:.4g} {unit}, and the limit is {limit:.4g} {unit} now: run the batch of this lot again"
    ),
    "stale_limit_open": (
        "judged against {judged:.4g} {unit}, and the lot states no limit any more: run the batch of this lot again"
    ),
    # Why one audit of a lot is set aside.
    "doubt.one_recording": (
        "its audit is set aside: it is the same recording as that of {other}; one of the two is of another unit: bring "
        "the right file, or confirm this one"
    ),
    "doubt.exchanged": (
        "its audit is set aside: it rests at {rest:.4g}, where {other} does, and not at {unit_rest:.4g}; the audits "
        "look exchanged: bring the right files, or confirm this one"
    ),
    "doubt.gain": (
        "its audit is set aside: its estimates are {gain:.3g} x the reference, those of the {others} others "
        "{usual:.3g} x; is its reference in another unit, or of another sensor? Bring it anew, or confirm it"
    ),
    "doubt.stranger": (
        "its audit is set aside: it rests at {rest:.4g} where its unit rests at {unit_rest:.4g}, and the {others} "
        "others rest where their units do; is it of another unit? Bring the right file, or confirm this one"
    ),
    "forecast_only": "its error is a forecast, which promises nothing until audits of enough units speak for it",
    "not_qualified": "not released by sample: {why}",
    "part.here": "{audits} audited units of this lot",
    "part.of_lots": "{audits} audited units of {lots} earlier lots",
    "part.unqualified": (
        "{audits} audited units of this lot; {why}; audit {missing} more units of this lot, drawn by its audit plan"
    ),
    "part.unqualified_small": "{audits} audited units of this lot; {why}; {small}",
    "part.small_lot": (
        "its {units} units are no more than the {wanted} audits a promise takes: measure every one of them, or audit "
        "{wanted} units in {least} or more earlier lots of this sensor model"
    ),
    "part.no_model": "the lot names no sensor_model, so no earlier lot counts for it",
    "part.no_lot": "no earlier lot was audited",
    "part.other_method": "the audits of earlier lots are of another sensor model or method",
    "part.old_audits": "the audits of earlier lots are older than {days:g} days",
    "part.withdrawn": "a failed audit or golden unit withdrew what earlier lots had shown",
    "part.few_lots": "{audits} audited units of {lots} earlier lots are too few ({least} lots are needed)",
    # The statement on the units of a lot that nobody measured.
    "release.unqualified": "no unit is released by sample: {why}",
    "release.none_left": "no unit is left to release by sample: {seen}",
    "release.poor": (
        "no unit is released by sample: {seen}; fewer than {part:.0%} of the lot, or of the other {open} units, would "
        "pass at {factor:.2g} x their forecast"
    ),
    "release.promised": (
        "with {seen}: at most {risk:.0%} of the {released} units released by sample (of {open} unmeasured) are beyond "
        "{limit:.3g} {unit}, {confidence:.0%} confidence; {any_form}"
    ),
    "release.gains": ("the audited units read {centre:.1%} of their loads, with a spread of {spread:.1%} between them"),
    "release.days": "up to {day:.3g} {unit} is kept for another day, as golden runs show it",
    "release.doubts": "audits that may be wrong do not count: {serials}",
    "part.audits_beyond": "{audits}, {beyond} of them beyond {limit:.3g} {unit}",
    "part.any_form": (
        "whatever form the ratios have, at most {share:.1%} at that confidence and {risk:.1%} on average"
    ),
    "part.any_form_mean": "whatever form the ratios have, at most {risk:.1%} on average",
    "sampled.released": (
        "released by sample: forecast {rmse:.3g} {unit} times {factor:.2f}, the most that {audits} leave open, is "
        "within the limit {limit:.3g} {unit}; risk {risk:.0%} at {confidence:.0%} confidence"
    ),
    "sampled.open": (
        "not released by sample: forecast {rmse:.3g} {unit} times {factor:.2f}, the most that {audits} leave open, is "
        "above the limit {limit:.3g} {unit}; measure this unit"
    ),
    "sampled.day": (
        "not released by sample: forecast {rmse:.3g} {unit} times {factor:.2f}, the most that {audits} leave open, is "
        "within the limit {limit:.3g} {unit}, but not with the {day:.3g} {unit} that golden runs show from day to day"
    ),
    "sampled.part": (
        "not released by sample: fewer than half of the lot would pass after {audits}; measure this unit, or find out "
        "why forecasts of this lot are out by {centre:.2f}"
    ),
    "sampled.beyond": (
        "forecast {rmse:.3g} {unit} times {centre:.2f}, the mean of measured over forecast error of {audits}, is above "
        "the limit {limit:.3g} {unit}"
    ),
    "bridge.measured": (
        "fitted to the golden run of its sitting; that day changes what the golden unit reads by {day:.3g} {unit} RMS, "
        "which the forecast holds"
    ),
    "bridge.read": (
        "fitted to the golden run of its sitting, which no load cell measured: what that day does to the golden unit "
        "itself is not known"
    ),
    "bridge.unused": (
        "the golden run shares no load with the unit at equal time (rank correlation {correlation:.2f}): fitted to the "
        "source's recording; press golden unit and units by one programme from one start"
    ),
    "line.stated": (
        "the forecast holds {rmse:.3g} {unit} for the line: it loads units that give the same output {share:.1%} "
        "differently, as was stated for it"
    ),
    "line.open": (
        "no output shows how hard the line pressed: a spread of {share:.1%} of the load, the default where none is "
        "stated, is {rmse:.3g} {unit} beside the forecast; state [line] in lot.toml, or audit"
    ),
    "trimmed": "trimmed by {loads} known loads: RMSE there {before:.3g}, now {after:.3g}; not measured since",
    "audited_before_trim": "its audit was taken before the trim, with the map of then; a new audit decides",
    "predicted_otherwise": "before the audit it was predicted {verdict}: {why}",
    # What is wrong with a table that was to audit a unit.
    "audit.unreadable": (
        "its audit cannot be read: {error}; bring it with `softcal lot audit`, which takes the column names of import"
    ),
    "audit.stranger": "the lot has no unit {serial}; call the file by the serial of the unit",
    "audit.no_reference": "it has no reference; choose the column of the load cell",
    # What the raw output shows.
    "dead.constant": "dead channel: output is constant at {level:.6g} {unit} in all {count} samples; {cure}",
    "dead.noise": "dead channel: output is noise alone (SD {spread:.3g} {unit}); {cure}",
    "dead.small": "dead channel: output moves by {span:.3g} {unit}, the source's by {source_span:.3g} {unit}; {cure}",
    "part.check_cable": "check cable and contact, press the unit and record it again",
    "saturated": (
        "clipped range: presses end flat at {level}, {share:.1%} of the samples; check gain and supply of the readout"
    ),
    "part.level": "{level:.6g} {unit}",
    "part.levels": "{low:.6g} {unit} and {high:.6g} {unit}",
    "stuck": "frozen reading: output does not move for {seconds:.1f} s in mid-range; check the cable",
    "too_little_data": (
        "too little data: {windows} windows and {presses} presses; at least {enough_windows} windows and "
        "{enough_presses} presses are needed for a firm verdict"
    ),
    # What the map shows.
    "unfamiliar": ("unfamiliar: {share:.0%} of the mapped windows lie outside what the source has shown; {cause}"),
    "part.fast": "its fast movements are unlike the source's: other sensor type, readout or rate",
    "part.loads": "other loads or speeds than the source has seen: wrong programme, or another sensor type",
    "not_covered": (
        "profile not covered: the unit was {what} from {low:.3g} to {high:.3g} {unit}, {share:.0%} of the source's "
        "{least:.3g} to {most:.3g} {unit}; loads beyond are extrapolated"
    ),
    "part.pressed": "pressed",
    "part.loaded": "loaded",
    "wrong_programme": (
        "wrong programme: the mix of loads and speeds overlaps the source's by {share:.0%}, fast movements are "
        "{speed:.2g} x as fast; press the unit as the source was pressed, or it behaves otherwise"
    ),
    "stretched": (
        "the map takes the unit's output times {gain:.2g}: it answers otherwise than the source, or was pressed over "
        "another part of the source's range, below half of it for example; its output cannot tell which: press it over "
        "the whole range, or give two known loads"
    ),
    "misread": (
        "reads other loads than the source at equal stage position and history, by {slow:.3g} {unit} for a second and "
        "longer: strong creep, lag, clipping or another sensor type"
    ),
    "drift": ("drift inside the recording: estimates at rest move by {moved:+.3g} {unit}; warm up, record again"),
    "creep": (
        "unsteady at rest: estimates scatter by {spread:.3g} {unit} between presses: strong creep or a loose mount"
    ),
    "rule.held": "{sentence} (rule {rule})",
    "rule.broken": (
        "rule {rule} could not judge the unit ({error}): repair the package that brings it, or uninstall it, and run "
        "the lot again"
    ),
    "late": (
        "output follows the source's {lag:.2f} s late in the opening both share: slow readout, or another clock; what "
        "happens faster than that is lost to the map"
    ),
    "lagging": (
        "slow readout: the output follows the source's under the same load like behind a filter of {lag:.2g} s more; "
        "check the filter and rate of its readout, and that it is of the source's type"
    ),
    "reversed": (
        "wrong wiring: the output moves against the source's direction; exchange the two leads or check the divider"
    ),
    "not_better": (
        "the map changes the estimates by {correction:.3g} {unit} but {why}: it may be worse than doing nothing"
    ),
    "part.uncertain": "is uncertain by {doubt:.3g} {unit}",
    "part.no_nearer": "brings the unit's use no nearer to the source's (overlap {gained:+.0%})",
    # What is wrong with recordings that a diagnosis is given, and what would repair them.
    "data.rate": "the time stamps show {seen:.4g} Hz, sample_rate_Hz says {stated:.4g} Hz",
    "data.repair.rate": "correct the one that is wrong; if the time stamps are right, sample_rate_Hz is {seen:.4g}",
    "data.repair.unit": "multiply {channel} by {factor:.4g}: it looks like {unit}",
    "data.swapped_columns.steps": "another column than output_V stands on the steps of the ADC, output_V does not",
    "data.swapped_columns.smooth": "force_N is as smooth as a commanded position, stage_mm as noisy as a force",
    "data.repair.swap": "exchange the headings {one} and {other}",
    "data.out_of_range.output": (
        "output_V reaches {worst:.6g} V, an ADC with {vref:.4g} V cannot read that; {count} samples out of range"
    ),
    "data.out_of_range.strays": (
        "{count} samples of {channel} lie far out, up to {worst:.6g} {unit}; nearly all others from {low:.4g} to "
        "{high:.4g} {unit}"
    ),
    "data.repair.samples": "leave out the {count} samples, or record the run again; check cable and transmission",
    "data.repair.sign": "reverse the sign of {channel}",
    "data.swapped_runs": (
        "{channel} does not follow the other columns of its run (correlation {now:.2f}), but those of another run "
        "({exchanged:.2f})"
    ),
    "data.repair.exchange": "exchange {channel} of runs {one:g} and {other:g}",
    "data.sign": "{channel} moves against the press: a press makes stage, force and output larger",
    "data.swapped_divider": (
        "the output falls when the sensor is pressed (correlation {correlation:.2f}): sensor and series resistor are "
        "exchanged in the divider"
    ),
    "data.repair.divider": "exchange them, or take Vref less the output where that is how it is wired",
    "data.unit.stiffness": (
        "peak force over depth is {seen:.3g} N/mm; pads have {low:.3g} to {high:.3g} N/mm; state stiffness_N_mm in "
        "recording.json if this one is right"
    ),
    "data.unit.size": "{channel} moves by {seen:.3g} {unit}, far from what a pad is pressed by",
    "data.repair.gain": "multiply {channel} by {factor:.4g}, or find out what changed its gain",
    "data.repair.zero": "subtract {offset:.4g} {unit} from {channel}: its zero was not set",
    "data.run.apart": "{channel} of this run is {ratio:.3g} times what the other runs show",
    "data.run.gain": (
        "{channel} of this run is {ratio:.4g} times what all other runs show; that alone explains {share:.0%} of what "
        "the twin leaves"
    ),
    "data.run.zero": (
        "{channel} of this run is off by {offset:+.4g} {unit} from all other runs; that alone explains {share:.0%} of "
        "what the twin leaves"
    ),
    "data.run.other_unit": (
        "this run fits a unit of other stiffness ({stiffness:+.0%}), resistance ({resistance:+.0%}) and sensitivity "
        "({sensitivity:+.0%}) than all other runs; that alone explains {share:.0%} of what the twin leaves"
    ),
    "data.repair.other_unit": "leave the run out, or record it again with this unit",
    # Why there is no map at all.
    "no_swing": "output makes no swing that stands out of its noise; press the unit and record it again",
    "still": "output stays at {level:.6g} {unit}; press the unit and record again",
    "still.shared": "output stays at {level:.6g} {unit} under the loads it shares with the source",
    "not_synchronous": (
        "outputs of source and unit agree with rank correlation {correlation:.2f} at equal time; they were not pressed "
        "by one load at once"
    ),
    "few.times": "{windows} windows at equal times; at least {enough} are needed",
    "few.positions": "{windows} windows at equal stage positions; at least {enough} are needed",
    "no_position": "stage position is not in both recordings; windows cannot be paired by it",
    "unreadable": "recording not readable: {error}",
    "wrong_loads": "its known loads cannot be used: {error}",
    "wrong_golden": "the golden run it was pressed beside cannot be used: {error}",
    "worker_died": "the process that fitted it died; calibrate the lot again",
    "defect": "softcal could not calibrate it ({error}); this is a defect of softcal, the log has the details",
    **GAP_SENTENCES,
    **SENTENCES,
}
"""One sentence a code. Values stand in braces with their format; a value that is a reason is a phrase of its own."""


@dataclass(frozen=True)
class Reason:
    """One thing that is said of a unit, a station or a file.

    Args:
        code: which sentence of `ENGLISH`.
        values: its numbers (with the physical unit beside them as `unit`), names and phrases.
    """

    code: str
    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.code not in ENGLISH:
            raise ValueError(f"reason {self.code!r} is none of {', '.join(ENGLISH)}")

    def __hash__(self) -> int:
        return hash((self.code, tuple(sorted(self.values.items(), key=lambda item: item[0]))))

    def __str__(self) -> str:
        return self.said(ENGLISH)

    def said(self, sentences: Mapping[str, str]) -> str:
        """Return the sentence in one language.

        Args:
            sentences: by code, as `ENGLISH`; what a language lacks is said in English.
        """
        values = {name: v.said(sentences) if isinstance(v, Reason) else v for name, v in self.values.items()}
        return filled(sentences.get(self.code, ENGLISH[self.code]), values)

    def to_json(self) -> dict[str, object]:
        """Return it as JSON values; `of` reads it back."""
        values = {name: v.to_json() if isinstance(v, Reason) else v for name, v in self.values.items()}
        return {"code": self.code, "values": values}

    @classmethod
    def of(cls, kept: object) -> "Reason":
        """Read a reason that was kept: `to_json`, or the sentence an older version kept.

        A code this version does not know stays readable as its own name.
        """
        if isinstance(kept, Reason):
            return kept
        if not isinstance(kept, Mapping):
            return plain(str(kept))
        code, values = str(kept["code"]), kept["values"]
        if code not in ENGLISH:
            return plain(" ".join([code, *(f"{name} {value}" for name, value in values.items())]))
        return cls(code, {name: cls.of(v) if isinstance(v, Mapping) else v for name, v in values.items()})


class _Filler(Formatter):
    """Fills a sentence; a word in the place of a number ("nan", or a value of another version) stands as it is."""

    def format_field(self, value: Any, format_spec: str) -> str:
        text: str = super().format_field(value, "" if isinstance(value, str) else format_spec)
        return text


def filled(sentence: str, values: Mapping[str, object]) -> str:
    """Return a sentence with its values filled in."""
    return _Filler().vformat(sentence, (), values)


def reason(code: str, /, **values: Value) -> Reason:
    """Return the reason of a code, its values as JSON can keep them.

    NumPy numbers become plain ones. A number that is none (nan, inf) becomes its word: whatever a device reported, the
    sentence about it is said.
    """
    return Reason(code, {name: _plain_value(value) for name, value in values.items()})


def plain(text: str) -> Reason:
    """Return a sentence as it stands: of an older version, or quoted from a file or a device."""
    return Reason(PLAIN, {"text": text})


def to_kept(why: Reason | str) -> object:
    """Return what a table keeps of a reason: its code and values, or the sentence where it is one."""
    found = Reason.of(why)
    return str(found) if found.code == PLAIN else found.to_json()


def packed(reasons: Iterable[Reason | str]) -> str:
    """Return reasons as one text for a column that holds messages; `unpacked` reads them back."""
    said = tuple(map(Reason.of, reasons))
    if not any(why.code != PLAIN for why in said):
        return joined(said)
    return json.dumps([why.to_json() for why in said], ensure_ascii=False)


def unpacked(message: str) -> tuple[Reason, ...]:
    """Return the reasons that a message was packed from; another message is one sentence."""
    if not message.startswith('[{"code"'):
        return (plain(message),) if message else ()
    return tuple(map(Reason.of, json.loads(message)))


def several(reasons: Sequence[Reason], code: str = "and") -> Reason:
    """Return reasons as one, where a single one is wanted.

    Args:
        code: of the sentence that holds a `first` one and the `rest`.
    """
    first, *rest = reasons
    return reason(code, first=first, rest=several(rest, code)) if rest else first


def root_of(why: Reason) -> Reason:
    """Return what a run died of, without what became of its stage."""
    inner = why.values.get("why") if why.code == "rig.aborted" else None
    return root_of(inner) if isinstance(inner, Reason) else why


def joined(reasons: Iterable[Reason]) -> str:
    """Return several reasons as one English line."""
    return "; ".join(str(one) for one in reasons)


def _plain_value(value: Value) -> Value:
    if isinstance(value, str | Reason):
        return value
    number = value.item() if hasattr(value, "item") else value
    return str(number) if isinstance(number, float) and not math.isfinite(number) else number
