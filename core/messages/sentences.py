"""What softcal says of units and verdicts, in English, and how a page of sentences is read."""


def sentences(page: str) -> dict[str, str]:
    """Return the sentences of a page by code: `code: sentence`, going on where a line is indented."""
    lines = page.replace("\n  ", " ").splitlines()
    return dict(line.split(": ", 1) for line in lines if line and not line.startswith("#"))


UNIT_SENTENCES = sentences("""
# The statement on an error, forecast or measured.
statement: its {source} error is {relation} (RMSE {rmse:.3g} {unit}, 95 %: {lower:.3g} to
  {upper:.3g}, limit {limit:.3g} {unit}, {origin})
no_limit: no limit was stated, so nothing passes; its {source} error is {rmse:.3g} {unit}, {share:.1%}
  of the range (95 %: {lower:.3g} to {upper:.3g})
part.predicted: predicted
part.measured: measured
part.within: within the limit
part.within_close: within the limit, but too near to it to be sure
part.above: above the limit
part.above_close: above the limit, but too near to it to be sure
part.stated: stated for the lot
part.automatic: {factor:g} x the source's own error of {rmse:.3g} {unit}, since no limit was stated
reference_missing: reference {cell} is named and has no certificate, so no unit passes; add its
  certificate on the page Load cells, then calibrate the lot again
reference_expired: the certificate of reference {cell} was not valid when the source was pressed, so
  no unit passes; press the source again with a valid certificate (certificate {number}, valid from
  {issued_on} to {due_on}, source pressed on {used_on})
reference_range: the source was pressed harder than the certificate of its reference covers, so no
  unit passes; press the source again with a lower load or another load cell (pressed up to
  {highest:.4g}, certificate {number} up to {capacity:.4g})
reference_uncertain: the reference itself is too uncertain for this limit, so no unit can pass; use
  a better load cell or agree on a larger limit (U_ref = {expanded:.3g} {unit}, k = 2)
harmful: the calibration makes this unit worse than no calibration; do not use it (RMSE {after:.3g}
  {unit} with it, {before:.3g} {unit} without it)
stale_limit: the limit was changed after this verdict; calibrate the lot again (judged against
  {judged:.4g} {unit}, limit now {limit:.4g} {unit})
stale_limit_open: the limit of the lot was taken back after this verdict; calibrate the lot again
  (judged against {judged:.4g} {unit})

# What of a table or a lot folder is not used, and why.
unused.format: it is no table of a kind that is read here ({suffixes})
unused.folder: folders inside a folder are not read, except source/ and units/
unused.place: recordings lie in source/, units/, audit/ and golden/
unused.source: the lot does not name this source (it names: {sources})
unused.foreign_unit: units/ has no unit of this serial
unused.column: nobody asked for this column
unused.unit_column: of a unit, t_s, output and stage_mm are read
unused.labelled: no fit reads a reference in units/; put the labelled recording into audit/
unused.reference: the reference of a target unit is read where audits are asked for
unused.no_column: {file} has no column {column}, it has {others}
unused.rows: they are outside {rows} (rows: {count}, in all: {total})

# What is odd of a lot and no error.
lot.no_units: the lot has no unit beside its source
lot.same_recording: units {units} have one and the same recording; check which serial it belongs to
lot.golden_is_source: the golden run of {serial} in lot {lot} is its source recording of lot
  {source_lot} itself; press {serial} again in the sitting of the units

# Why one audit of a lot is set aside.
doubt.one_recording: its audit does not count for now; its recording is the same as that of {other},
  so one of them is of another unit; bring the right file, or confirm this one
doubt.exchanged: its audit does not count for now; it looks exchanged with that of {other}; bring
  the right files, or confirm this one (output at rest in the audit {rest:.4g}, of this unit
  {unit_rest:.4g})
doubt.gain: its audit does not count for now; its reference may be in another unit, or of another
  sensor; bring it again, or confirm it (estimates are {gain:.3g} x the reference, in other audits
  {usual:.3g} x, other audits: {others})
doubt.foreign_unit: its audit does not count for now; it may be of another unit; bring the right file,
  or confirm this one (output at rest in the audit {rest:.4g}, of this unit {unit_rest:.4g}, other
  audits, which agree with their units: {others})
forecast_only: its error and its interval are only predicted, not measured; nothing is promised
  until enough units are audited
not_qualified: not released by sample; {why}
part.here: audited units of this lot: {audits}
part.of_lots: audited units of earlier lots: {audits}, lots: {lots}
part.unqualified: too few units of this lot were drawn and then audited; {why}; audit {missing} more,
  drawn by the audit plan (so far: {audits})
part.unqualified_small: too few units of this lot were drawn and then audited; {why}; {small}; so far:
  {audits}
part.small_lot: the lot is too small for a release by sample; measure every unit, or audit earlier
  lots of this sensor model (units: {units}, audits needed: {wanted}, earlier lots needed: {least})
part.no_model: the lot names no sensor model, so audits of earlier lots do not count
part.no_lot: no earlier lot was audited
part.other_method: audits of earlier lots do not count, since sensor model or method was another
part.old_audits: audits of earlier lots are too old (they count for this many days: {days:g})
part.withdrawn: a later audit or golden unit failed, so audits of earlier lots do not count
part.few_lots: earlier lots have too few audits (audited units: {audits}, lots: {lots}, lots needed:
  {least})

# The statement on the units of a lot that nobody measured.
release.no_limit: no unit is released by sample, since no limit was stated for the lot
part.no_limit: no limit was stated for the lot
release.unqualified: no unit is released by sample; {why}
release.none_left: no unit is left to release by sample ({seen})
release.poor: no unit is released by sample; too few units of this lot would pass; measure units one
  by one, or find the cause ({seen}, forecasts taken times {factor:.2g}, units not measured: {open},
  share that must pass: {part:.0%})
release.promised: units released by sample: {released}; at most {risk:.0%} of them are beyond the
  limit of {limit:.3g} {unit}, with {confidence:.0%} confidence (units not measured: {open},
  {seen}); {any_form}
release.gains: on average the audited units read {centre:.1%} of the true load; from unit to unit
  this differs by {spread:.1%} (standard deviation)
release.sitting: units of one sitting share the error of their common load: the audits measure it once, and speak for
  that sitting alone (audits: {audits}, units of other sittings: {others})
release.sittings: units of one sitting share the error of their common load: sittings are counted, not units (audits:
  {audits}, sittings: {sittings}, needed: {least})
release.days: a part of the limit is kept for changes from day to day, as the golden unit shows them
  (up to {day:.3g} {unit})
release.common: what the audited units misread alike was taken off every map of the lot, and all
  numbers here are those after it (audits: {audits})
common: its map takes off what the audited units of its lot misread alike (gain {gain:.3f}, zero
  {zero:.3g} {unit}, audits: {audits})
release.doubts: some audits may be wrong and do not count; look at them on the page Audit (units:
  {serials})
part.audits_beyond: {audits}, of these beyond {limit:.3g} {unit}: {beyond}
part.any_form: with no assumption on the errors, at most {share:.1%} at that confidence and
  {risk:.1%} on average
part.any_form_mean: with no assumption on the errors, at most {risk:.1%} on average
sampled.released: released by sample; by the audited units its error is within the limit, with a
  risk of {risk:.0%} (forecast {rmse:.3g} {unit}, times {factor:.2f} at most, limit {limit:.3g}
  {unit}, {confidence:.0%} confidence, {audits})
sampled.open: not released by sample; by the audited units its error may be above the limit; measure
  this unit (forecast {rmse:.3g} {unit}, times {factor:.2f} at most, limit {limit:.3g} {unit},
  {audits})
sampled.day: not released by sample; its error is within the limit today, but changes from day to
  day may take it above; measure this unit (forecast {rmse:.3g} {unit}, times {factor:.2f} at most,
  limit {limit:.3g} {unit}, golden unit from day to day {day:.3g} {unit}, {audits})
sampled.part: not released by sample; fewer than half of the lot would pass; measure this unit, or
  find out why the forecasts of this lot are wrong (measured error {centre:.2f} x the forecast,
  {audits})
sampled.beyond: by the audited units its error is above the limit; measure this unit before it is
  used (forecast {rmse:.3g} {unit}, times {centre:.2f} as measured, limit {limit:.3g} {unit},
  {audits})
bridge.measured: fitted to the golden unit's run of its own day; that day changes what the golden
  unit reads, and the forecast allows for it (by {day:.3g} {unit} RMS)
bridge.read: fitted to the golden unit's run of its own day, which no load cell measured; how that
  day changes the golden unit is not known
bridge.unit: fitted to the loads of its sitting, which {serial} was pressed with under the load cell;
  that run is no audit
bridge.unused: the golden unit was not pressed at the same times as this unit, so its run was not
  used; press both with one programme from one start (rank correlation {correlation:.2f})
line.stated: the line presses differently {between}, as was stated for it; the forecast allows for that
  ({share:.1%} of the load, {rmse:.3g} {unit})
line.open: the forecast leaves out how differently the line presses {between}, since nobody stated
  it; audit units, or ask the engineer to state it (the usual {share:.1%} of the load is {rmse:.3g}
  {unit} here)
part.units: from unit to unit
part.days: from day to day
part.units_and_days: from unit to unit and from day to day
trimmed: trimmed by known loads and not measured since; audit it for a firm verdict (loads: {loads},
  RMSE there {before:.3g} before, {after:.3g} now)
trim.older: its trim was made before this recording and is left out; trim it again where it is used,
  or audit it (known loads: {loads})
trim.read: its map needs no trim any more: it reads the loads of its last trim (known loads:
  {loads})
trim.left_out: its trim does not go with its new map; trim it again, or audit it ({error})
audited_before_trim: its audit was made before the trim and does not decide; audit it again
predicted_otherwise: before the audit it was predicted {verdict}: {why}

# What is wrong with a table that was to audit a unit.
audit.unreadable: its audit cannot be used: {error}; bring it again on the page Audit and choose its
  columns there
audit.foreign_unit: the lot has no unit {serial}; name the file by the serial of its unit
audit.no_reference: the file has no reference; choose the column of the load cell

# What one look at a recording shows.
part.at_line: line {number} ({at:.3f} s)
part.at_row: row {number} ({at:.3f} s)
part.at_time: at {at:.3f} s
part.value_at: {value:.7g}, {place}
inspect.missing: {where}, {column}: no number (rows: {rows})
inspect.overflow: {where}, {column}: {value:.7g}, {amount:.2g} times the range of the others (rows:
  {rows})
inspect.spike: {where}, {column}: away to {value:.6g} and back, faster than any press (rows: {rows})
inspect.dropout: {where}, {column}: away to {value:.6g}, and back later (rows: {rows})
inspect.step: {where}, {column}: its level jumps by {value:.4g} and stays ({amount:.0%} of the range)
inspect.wrap: {where}, {column}: a jump by {value:.6g}, as of a counter that starts again
inspect.stuck: {where}, {column}: it stands still at {value:.6g} in the middle of a press (for
  {amount:.1f} s)
inspect.sign: {column}: negative under load ({value:.4g} at the 1 % quantile)
inspect.of_unit: audit of {serial}: {what}
inspect.other_unit: reference: its range is about {times:.3g} times the source's; {factor:.4g} lies
  between {unit} and {named}; nothing was converted
inspect.other_sign: {column}: its sign is not that of the source's; nothing was turned
inspect.clipped: {where}, {column}: it ends flat at {value:.6g} time and again (samples: {amount:.0f}):
  cut off at the end of its range, or held there
inspect.constant: {column}: it never changes ({value:.6g}, rows: {rows})
inspect.gap: {where}: rows are missing before it (for {seconds:.2f} s, samples: {missing:.0f})
inspect.pause: {where}: the logger paused before it while the output was at rest (for {seconds:.1f} s)
inspect.rate: {where}: from here on rows come at another rate ({rate:.4g} Hz, rows: {rows})
inspect.tare: {where}: the reference jumps by {value:.4g} and stays, while the output does not: it was
  tared or set anew within the recording ({share:.0%} of the range)
inspect.held: the reference was logged slower than the output ({rate:.3g} Hz, rows of one value:
  {rows:.0f})
inspect.late: the reference comes {seconds:.2f} s later than the output
inspect.early: the reference comes {seconds:.2f} s earlier than the output
inspect.several: {first}; {more} more like it
inspect.unusable: {finding}; {cure}
part.cure_tare: take the jump off the rows from there on, or bring a recording without it
part.cure_held: log both at one rate
part.cure_lag: shift the reference by that time, or set both clocks alike
part.cure_constant: check the channel of the reference

# What is missing of a recording.
samples_missing: samples are missing, so nothing firm can be said: {observed}; bring the logger's whole file,
  or find out why the logger loses samples (missing {share:.0%} of the samples, windows left
  {windows:.0%})
masked.missing: rows of its file have no number, and are left out (samples: {count}, the first: {first})
masked.overflow: its file holds values that no sensor gives, as loggers write them in place of a
  sample; they are left out (samples: {count}, the first: {first}, up to {times:.2g} times the range
  of the others)
masked.spike: its output jumped away and back faster than any press, as with a loose cable; these
  samples are left out (samples: {count}, the first: {first})
masked.dropout: its output jumped away for a while and came back, as with a cable that is off; these
  samples are left out (samples: {count}, the first: {first})
masked.no_reference: rows of its file have no reference, and are left out (samples: {count}, the
  first: {first})
masked.reference_outlier: its reference jumped away and back faster than any press; these samples are
  left out (samples: {count}, the first: {first})
gaps: its time stamps have gaps: rows are missing (gaps: {gaps}, the longest {longest:.2f} s at
  {at:.2f} s, samples missing: {rows:.0f}, {share:.0%})
paused: its logger paused while the output was at rest (pauses: {pauses}, the longest {longest:.1f} s
  at {at:.2f} s)
slow: a part of it was sampled at a slower rate (from {first:.2f} s on {rate:.3g} Hz, elsewhere
  {usual:.3g} Hz)
wraps: its output is a counter that starts again in the recording; log it with more bits, or add the
  range back to the file (times: {count}, the first at {first:.2f} s by {jump:.6g})
stepped: the level of its output jumps in the recording and stays; look for a tare, another range of
  the readout, or a mount that slipped (at {first:.2f} s by {jump:.3g} {unit}, {share:.0%} of its
  range)

# What the raw output shows.
dead.constant: dead channel: its output never changes; {cure} (samples: {count}, all at {level:.6g}
  {unit})
dead.noise: dead channel: its output is only noise; {cure} (SD {spread:.3g} {unit})
dead.small: dead channel: its output hardly moves; {cure} (it moves by {span:.3g} {unit}, the
  source's by {source_span:.3g} {unit})
part.check_cable: check cable and contact, press the unit and record it again
saturated: its output is cut off at the end of the readout's range; check gain and supply of the
  readout (flat at {level}, {share:.1%} of the samples)
part.level: {level:.6g} {unit}
part.levels: {low:.6g} {unit} and {high:.6g} {unit}
stuck: its output stood still in the middle of a press; check the cable (for {seconds:.1f} s)
too_little_data: the recording is too short for a firm verdict; press the unit longer (windows:
  {windows}, needed {enough_windows}, presses: {presses}, needed {enough_presses})

# What the map shows.
unfamiliar: its signal is unlike anything the source has shown; {cause} ({share:.0%} of its windows)
part.fast: its fast movements differ; check sensor type, readout and sampling rate
part.loads: its loads or speeds differ; check the programme and the sensor type
not_covered: the unit was not {what} as far as the source, and loads beyond that are guessed; press
  it over the whole range ({low:.3g} to {high:.3g} {unit}, {share:.0%} of the source's {least:.3g}
  to {most:.3g} {unit})
part.pressed: pressed
part.loaded: loaded
wrong_programme: the unit was not pressed like the source: other loads or other speeds; press it
  again with the source's programme; if this comes back, the unit behaves otherwise ({share:.0%} of
  its use is like the source's, fast movements are {speed:.2g} x as fast)
stretched: it answers much more or less than the source, or was pressed over a part of the range
  only; press it over the whole range, or give two known loads (its output is taken times
  {gain:.2g})
misread: it reads other loads than the source at the same stage position; look for creep, a slow or
  cut-off readout, or another sensor type (by {slow:.3g} {unit}, for a second or longer)
drift: its zero moved during the recording; let it warm up, then record again (by {moved:+.3g}
  {unit})
creep: it does not come back to the same value between presses; look for a loose mount or a sensor
  that recovers slowly (scatter {spread:.3g} {unit})
rule.held: {sentence} (rule {rule})
rule.broken: rule {rule} could not judge the unit: {error}; ask the engineer to repair or remove its
  package, then calibrate the lot again
late: its output comes later than the source's; look for a slow readout or another clock; faster
  changes of load are lost ({lag:.2f} s late)
lagging: its readout is slower than the source's; check its filter and rate, and that it is of the
  source's type (time constant {lag:.2g} s longer)
reversed: its output moves in the wrong direction; exchange the two leads or check the divider
other_unit: its output is about {factor:g} times the source's, as if it was in another unit; check
  unit and scale of the readout, nothing was converted ({low:.4g} to {high:.4g} {unit}, the source
  {least:.4g} to {most:.4g} {unit})
elsewhere: its output lies where no unit like the source does; check the physical unit, the zero and
  the channel ({low:.4g} to {high:.4g} {unit}, the source {least:.4g} to {most:.4g} {unit})
other_speed: it went through the source's programme at another speed; correct the sampling rate, or
  record it again at the source's ({times:.3g} x as fast)
other_rate: it was sampled at another rate than the source, so that its windows last otherwise;
  correct the stated rate, or record it at the source's ({seen:.4g} Hz, the source {wanted:.4g} Hz)
not_better: its calibration may be worse than none; {why}; press it again over the whole range, or
  audit it (estimates change by {correction:.3g} {unit})
part.uncertain: it is more uncertain than what it corrects (by {doubt:.3g} {unit})
part.no_nearer: it hardly makes the unit more like the source (their likeness changes by {gained:+.0%})

# What is wrong with recordings that a diagnosis is given, and what would repair them.
data.rate: the time stamps show {seen:.4g} Hz, sample_rate_Hz says {stated:.4g} Hz
data.repair.rate: correct the one that is wrong; if the time stamps are right, sample_rate_Hz is
  {seen:.4g}
data.repair.unit: multiply {channel} by {factor:.4g}: it looks like {unit}
data.ask.unit: is {channel} in {unit}? Then multiply it by {factor:.4g}; the diagnosis holds either
  way
data.swapped_columns.steps: another column than output_V has the steps of the ADC; output_V has none
data.swapped_columns.smooth: force_N is as smooth as a commanded position, stage_mm as noisy as a
  force
data.repair.swap: exchange the headings {one} and {other}
data.out_of_range.output: output_V reaches {worst:.6g} V, which an ADC with {vref:.4g} V cannot read
  (samples out of range: {count})
data.out_of_range.strays: some samples of {channel} lie far out ({count} of them, up to {worst:.6g}
  {unit}, nearly all others from {low:.4g} to {high:.4g} {unit})
data.repair.samples: leave these samples out, or record the run again; check cable and transmission
  (samples: {count})
data.repair.sign: reverse the sign of {channel}
data.swapped_runs: {channel} does not follow the other columns of its run; it follows those of
  another run (correlation {now:.2f} here, {exchanged:.2f} there)
data.repair.exchange: exchange {channel} of runs {one:g} and {other:g}
data.sign: {channel} moves against the press: a press makes stage, force and output larger
data.swapped_divider: the output falls when the sensor is pressed; sensor and series resistor are
  exchanged in the divider (correlation {correlation:.2f})
data.repair.divider: exchange them, or take Vref less the output where that is how it is wired
data.unit.stiffness: the pad is stiffer or softer than such pads; if this is right, ask the engineer
  to state its stiffness with the case ({seen:.3g} N/mm, pads have {low:.3g} to {high:.3g} N/mm)
data.unit.size: {channel} moves by {seen:.3g} {unit}, far from what a pad is pressed by
data.repair.gain: multiply {channel} by {factor:.4g}, or find out what changed its gain
data.repair.zero: subtract {offset:.4g} {unit} from {channel}: its zero was not set
data.run.apart: {channel} of this run is {ratio:.3g} x what the other runs show
data.run.gain: {channel} of this run is {ratio:.4g} x what all other runs show (this alone explains
  {share:.0%} of what the twin leaves)
data.run.zero: {channel} of this run is off by {offset:+.4g} {unit} from all other runs (this alone
  explains {share:.0%} of what the twin leaves)
data.run.other_unit: this run looks as if another unit was pressed (stiffness {stiffness:+.0%},
  resistance {resistance:+.0%}, sensitivity {sensitivity:+.0%} against all other runs; this alone
  explains {share:.0%} of what the twin leaves)
data.cut_off: {channel} stands still at {level:.4g}; it may be cut off there (samples: {count})
data.repair.range: if the readout cuts {channel} off, widen its range; the diagnosis holds either
  way
data.louder: the scatter of {channel} from sample to sample is {scatter:.3g}, far more than its stated
  noise ({stated:.3g})
data.repair.louder: state the noise of {channel} anew, or leave it out: it is then read off the runs
data.dead: nothing changes in {channel}
data.repair.dead: check the cable and the logger, then record the run again
data.swapped: the simulator agrees with the recordings once {one} and {other} are exchanged, and not
  before
data.run.shifted: {channel} of this run agrees with the other runs in another unit alone
data.repair.shifted: take {factor:.4g} x {channel} {offset:+.4g}: it looks like {unit}
data.repeats: one value of {channel}, {level:.6g}, stands from {start:.4g} to {end:.4g} s, where it
  should move (samples: {count})
data.repair.repeats: look for a buffer that repeats, and leave these samples out; the diagnosis holds either
  way
data.repair.other_unit: leave the run out, or record it again with this unit

# Why there is no map at all.
no_swing: its output does not stand out of its noise; press the unit and record it again
still: its output stays at one value; press the unit and record it again ({level:.6g} {unit})
still.shared: its output stays at one value under the loads it shares with the source; check its
  cable, then record it again ({level:.6g} {unit})
lot_fit.alone: it shares no load in time with other units of the lot; its map is its own
lot_fit.changes: lot fit {number}: maps or intervals changed (units: {count})
lot_fit.few: too few share a load in time (units: {count}); each keeps its own map
lot_fit.known: its load is known better than by other units: its map rests on pairs or known loads
lot_fit.member: its map comes from lot fit {number}: it is paired with the load that units share (units: {units}), which
  is known to {common_rmse:.3g} {unit}; its own part to {unit_rmse:.3g} {unit}
lot_fit.named: mapped alone: {serial}: {why}
lot_fit.noisy: its output swings {times:.3g} times as often as those of the units it was pressed with, like noise; its
  map is its own
lot_fit.open: lot fit {number} would change maps (units: {count})
lot_fit.outlier: it was pressed otherwise than the units it was pressed with: once its map is paired with their load,
  {rmse:.3g} {unit} are left, usually {usual:.3g} {unit}; its map is its own
lot_fit.source.high: source {serial}: its network reads this lot {bias:.3g} {unit} above what the units agree on behind
  the other sources (sources: {count}), {rmse:.3g} {unit} RMS
lot_fit.source.low: source {serial}: its network reads this lot {bias:.3g} {unit} below what the units agree on behind
  the other sources (sources: {count}), {rmse:.3g} {unit} RMS
lot_fit.source.two: source {serial}: its network and that of the other source read this lot {rmse:.3g} {unit} apart; of
  two sources nobody can say which one errs: audit a unit or bring a golden run of its sitting
lot_fit.spread: the units differ more the harder they are pressed, by {share:.1%} of the load: the press differs from
  unit to unit, so they share no load; each keeps its own map, and the spread is in its forecast
not_synchronous: unit and source were not pressed by one load at the same time; press them together,
  or choose another map (rank correlation {correlation:.2f})
few.times: too little of the recording lies at the same times as the source's; record both for
  longer (windows: {windows}, needed: {enough})
few.positions: too little of the recording lies at the same stage positions as the source's; press
  both over the same range (windows: {windows}, needed: {enough})
no_position: the stage position is missing in one of the two recordings; record it in both, or
  choose another map
unreadable: recording not readable: {error}
wrong_loads: its known loads cannot be used: {error}
wrong_golden: the golden run it was pressed beside cannot be used: {error}
worker_died: its calibration was stopped before it was done; calibrate the lot again
defect: a defect of softcal stopped its calibration: {error}; tell the engineer, the log has the
  details
""")
