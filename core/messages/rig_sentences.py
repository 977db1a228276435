"""What stations, their gates and the registry say, in English: one sentence a code. Drivers bring their own."""

from softcal.core.messages.sentences import sentences

SENTENCES = sentences("""
# How a device is called.
device.stage: stage
device.cell: load cell
device.readout: sensor readout
device.gauge: gauge
device.readers: readers
device.at: {device} ({port})

# A run, a self-test and their stops.
rig.needs_cell: a source unit needs the load cell, and this station has none; nothing moved; ask the
  engineer to add it to the station file
rig.no_limit: without a load cell nothing limits the force; nothing moved; ask the engineer, who
  allows it in the station file (without_cell) where the stage can hurt nothing
rig.not_zero: load cell: does not read zero without a load; take everything off and zero it (reads
  {zero_N:.3g} N, at most {allowed_N:g} N is allowed)
rig.zero_moved: load cell: its zero moved during the run; let it warm up, check its mounting (by
  {change_N:.3g} N, {allowed_N:g} N is allowed)
rig.no_contact: no contact down to {deepest_mm:g} mm; is a unit in the fixture and connected?
rig.too_fast: profile {profile} is too fast for this unit: a stop could end above the load cell's
  limit; press at {slower_mm_s:.2g} mm/s or slower (now {speed_mm_s:g} mm/s, {force_N:.1f} N,
  {stiffness_N_mm:.1f} N/mm, a stop could end at {worst_N:.1f} N, limit {ceiling_N:.1f} N)
rig.few_readings: {device}: too few readings; check its cable and rate (readings: {count} in
  {read_s:g} s)
rig.one_weight: one weight gives no scale; use the unloaded cell and at least one weight
rig.not_following: load cell: the reading does not follow the weights; check its bridge and mounting
rig.number.reads: {device}: {quantity} reads {answer}; a number was expected
rig.outside.quantity: {device}: {quantity} = {value:g} {unit} is outside [{low:g}, {high:g}] {unit};
  nothing was sent
rig.no_contact.cell: load cell: shows no contact although the output has changed by {change:.3g};
  check the cell's bridge and cable
rig.port: {device}: {why}
rig.no_answer: {device}: no answer within {within_s:g} s; check cable, power and baud rate
rig.no_line_end: {device}: it sends no line end; check device and baud rate (bytes read: {count})
rig.gone: {device}: the device is gone (unplugged, switched off, or another program took the port);
  check its cable, then start again
rig.keyboard: stopped by the keyboard; {state}, the run is aborted
rig.aborted: {why}; {state}, the run is aborted
rig.not_home: stage: not at home after {seconds:g} s; look for what blocks it
rig.late: stage: {seconds:g} s late at {to_mm:.2f} mm; look for what blocks it, then home it
rig.lost.at_touch: stage: lost its position when it was stopped at the touch; home it
rig.too_deep: the profile would reach {to_mm:.2f} mm, the limit is {deepest_mm:g} mm; check the
  fixture
rig.late.lifting: stage: late while it was lifted
rig.behind: load cell: its readings come later than the stage moves; look for a slow line or a
  filter, or ask the engineer to state the delay in the station file (found {found_s:.3f} s, stated
  {declared_s:.3f} s, latency_s = {latency_s:.2f})
rig.low_pass: load cell: it follows the force too slowly; switch off the filter of its amplifier, or
  press more slowly (time constant {constant_s:.3f} s, labels wrong by {error_N:.3g} N RMS, at most
  {allowed_N:.3g} N)
rig.distorted: load cell: no delay and no filter explains its readings; look for an average, a limit of
  speed or an automatic zero of its amplifier, then press again (left of them by the depth: {percent:.1f} %
  of the force's range RMS)
rig.gain: load cell: one press shows another force than the next at equal depth; check the cell's
  amplifier, its mounting and the unit's seat, then press again ({ratio:.2f} x)
rig.odd_force: load cell: its force does not fit depth and output; check its plug and amplifier, and
  whether something touches unit or stage; then press again ({at_s:.1f} s after the first press began)
rig.slipped: stage: it is {lost_mm:.2f} mm off its count from {at_s:.1f} s after the first press began;
  check the motor for lost steps and the unit's seat, then press again
rig.output_fell: output at equal force fell by {percent:.0f} % at {at_s:.1f} s after the first press
  began; check the unit's connector and the supply of the sensor readout, then press again
rig.output_rose: output at equal force rose by {percent:.0f} % at {at_s:.1f} s after the first press
  began; check the unit's connector and the supply of the sensor readout, then press again
rig.output_drift: output at equal force drifts by {rate:+.3g} per s, {percent:.0f} % of its range
  over the run; let the sensor readout warm up, check its supply, then press again
rig.still: stage: its position stays at {at_mm:.2f} mm for {seconds:.1f} s although it should move;
  check the supply of the motor and the controller, then home it
rig.output_gain: sensor readout: one press changes the output more than the next at equal depth;
  check the motor for lost steps, the unit's seat and its connector; then press again ({ratio:.2f}
  x)
rig.contact_at_once: contact was found before the stage had moved; check the load cell's readings,
  and ask the engineer whether the approach (approach_mm) ends above the unit (moved {way_mm:g} mm
  at most)
rig.follows: sensor readout: its output hardly follows the depth of the stage; check the unit's
  connector and the motor's supply, then press again ({percent:.0f} % follows)
rig.host_paused: this computer stood still for {seconds:.1f} s and watched nothing meanwhile; keep it
  from sleep and from other work, then start the run again
rig.dropout: sensor readout: the output's cable was loose at {at_s:.1f} s: {level:.3g} {unit} for
  {lasts_s:.2f} s, {expected:.3g} {unit} before and after; check plug and cable, then press again
rig.bit: sensor readout: bit {bit} of its converter never changes; check the converter, then press
  again
rig.run_ended: run of {serial}: {end}; press the unit again
rig.run_facts: run of {serial}: what it says of itself does not fit its samples; press the unit
  again
rig.clock: {device}: its clock is off by {percent:+.1f} %; check its firmware
rig.lost: {device}: some samples were lost; check its cable, then record again (lost: {lost},
  samples: {count})
rig.gap: load cell: a gap of {seconds:.2f} s in its samples; check its cable, then record again
rig.force: force {force_N:.2f} N, {coming_N:.2f} N by the time the stage can brake: the limit is
  {limit_N:g} N; check unit, fixture and profile
rig.no_force: load cell: {force_N:.2f} N although the stage is {pressed_mm:.2f} mm below the
  contact; check the cell's bridge, the fixture and whether the stage is blocked
rig.jump: load cell: jumped from {before_N:.2f} N to {after_N:.2f} N while the stage stands still;
  check its cable and mounting, keep hands off the rig
rig.stuck: {device}: stays at {level:.4g} while the stage moves {stuck_mm:.1f} mm on the unit; check
  the motor's supply, the channel and its cable
rig.silent: {device}: nothing for {seconds:.2f} s; check its cable and supply, then start the run
  again
rig.old: {device}: its readings have become {age_s:.2f} s old; check hub, cable and what else the
  computer does, then start the run again
rig.rail: {device}: at the end of its range for {rail_s:g} s; check the unit's connector (open or
  short circuit)
rig.rate: {device}: loses samples or sends at another rate; check cable and firmware, or ask the
  engineer to correct the station file ({count} in {span_s:.2f} s, expected {rate_Hz:g} Hz)
rig.no_position.known: stage: does not say where it is; check its cable
rig.defect: a defect of softcal ended the run; its log has more
rig.silent.between: {device}: nothing for {seconds:.0f} s; check its cable and supply
rig.stopped: the station is stopped: {why}
rig.no_devices: the station has no open devices; acknowledge first
rig.self_test: self-test of {device}, {what}: {value}; {cure}
rig.all_good: all devices are good
rig.by_hand: stopped by a person
rig.profile.speed: profile {profile} moves at {speed_mm_s:g} mm/s, the station allows {most_mm_s:g}
  mm/s; nothing moved
rig.profile.depth: profile {profile} goes to {to_mm:g} mm, the station allows {most_mm:g} mm below
  its approach; nothing moved
rig.library.ended: {device}: its library ended with {what}; check its cable, then start again
rig.library.silent: {device}: no new reading for {seconds:.2f} s; its library hangs or repeats the
  last one, check its cable and supply, then start again
rig.homing.rises: the force rises by {force_N:.1f} N while the stage homes; check that it homes away
  from the unit
rig.in_the_way: something is in the way of the stage; look at unit and fixture, or ask the engineer
  to correct the approach in the station file (approach_mm; {force_N:.2f} N at {position_mm:.2f} mm)
rig.deepest: stage at {at_mm:.2f} mm, the limit is {deepest_mm:g} mm; check the fixture
rig.not_homed: stage: not homed; nothing was sent, home it first
rig.moving: stage: the move before is not finished; nothing was sent
rig.outside.travel: stage: {to_mm:g} mm is outside [0, {travel_mm:g}] mm; nothing was sent
rig.outside.speed: stage: {speed_mm_s:g} mm/s is outside {bounds} mm/s; nothing was sent
rig.channels: a line has the wrong number of channels ({count}, expected {expected}); check the
  readout
rig.clock.back: {device}: its clock went from {before_ms} ms to {after_ms} ms; the device started
  again, check its supply and its cable
rig.unreadable: {device}: its lines cannot be read; check cable and baud rate (lines in a row:
  {count}, the last: {why})
rig.force_unit: load cell: unit {unit} is not known; set it to N
rig.acknowledge: acknowledge first

# What became of the stage.
left.stopped: the stage is stopped
left.held: the stage stands where somebody holds it and is not lifted
left.must_home: the stage is stopped and must be homed
left.lifted: the stage is stopped and lifted
left.lifted_roughly: the stage is stopped and lifted, it must be homed
left.not_lifted: the stage is stopped but could not be lifted: lift it by hand and home it
left.told: the stage is stopped and told to lift, which is not confirmed
left.stays: the stage was told to lift but the force stays: lift it by hand and home it
left.there: the stage is stopped and not lifted
left.runs_on: the stage does not answer any more, it stops within {seconds:.1f} s: switch it off
  before you reach in
left.unreachable: the stage does not answer any more, it ends the move it has: switch it off before
  you reach in
left.may_stand: {state}, it may stand on the unit
left.stands: {state}, with {force_N:.1f} N on the load cell; the controller counts {at_mm:.2f} mm
left.stands_lost: {state}, with {force_N:.1f} N on the load cell; the position is not known

# A port that cannot be opened.
port.unreached: cannot be reached: {error}; check address, power and network cable
port.visa: cannot be opened: {error}; `pyvisa-shell` lists the resources there are
port.none: no such port; check the cable, then find and test the rig to see the ports there are
port.taken: in use by {owner}; end that program, one process owns a port
port.closed: cannot be opened: {error}
port.owner: {name} (process {process})

# What a port said, and what it is taken for.
port.unknown: answers in no dialect that softcal knows
port.said: says '{said}'
port.esm: Mark-10 stand without a gauge that answers
port.esm.gauge: Mark-10 stand, its gauge in {unit}
port.grbl: GRBL controller, {state}
port.zaber: Zaber device {device}
port.mark10: Mark-10 gauge in {unit}
port.loadstar: Loadstar {model}
port.bridge: counts from {smallest} to {largest}: beyond 16 bit or below 0, as a bridge amplifier of
  a load cell sends them
port.converter: counts up to {largest}, as the 12-bit converter of a readout sends them
port.either: counts up to {largest} at {rate_Hz:.0f} Hz: a load cell or a readout; the engineer says
  which in the station file
port.at: {port}: {why}
port.at.none: no USB serial port was found on this machine; plug the devices in, or use the
  simulated rig (looked for: a stage such as GRBL, Zaber or Mark-10, a load cell such as HX711,
  Mark-10, Loadstar or indicator, a sensor readout)
port.missing: not found: {parts}; looked at {ports}
port.one_of: {first} and {second} could each be {part}; name the ports you mean; nothing was written
part.stage: a stage
part.cell: a load cell
part.readout: a sensor readout
part.and: {first} and {rest}

# The station file.
station_file.no_port: [{section}] port is empty; write the port of that device there
station_file.unknown_kind: {section}.kind is {kind}; known are {known}
station_file.kind_twice: {section}.kind {kind} is offered by {packages}; uninstall all but one
station_file.broken_package: {section}.kind {kind}: {fault}; mend or uninstall {package}
station_file.same_port: [{name}] and [{other}] have the same port {port}; kinds {kind} and {kind2}
  cannot share it
station_file.unreadable: {path}: {error}; find and test the rig to write a new one
station_file.no_toml: {path}: is no TOML file: {error}
station_file.at: {path}: {why}
station_file.unknown_top: unknown key {key}; known are name, {known}
station_file.no_section: section [{section}] is missing
station_file.no_force: section [force] is missing, so nothing limits the force; the engineer adds
  the load cell to the station file; only where the stage can hurt nothing, [safety] has
  without_cell = true instead
station_file.no_table: {name} must be a section: write [{name}] and its keys below
station_file.wrong_wire: [{section}] port {port} is a {wire} port; kind {kind} speaks over {wires}
station_file.unknown_key: [{section}] unknown key {key}; known are {known}{similar}
station_file.no_key: [{section}] {key} is missing
station_file.wrong_type: {name} is {value}; {expected} was expected
station_file.outside: {name} is {value:g}; a value in [{low:g}, {high:g}] was expected
station_file.no_scale: force.counts_per_N is 0; calibrate the cell with weights first
  (calibrate-cell)
station_file.dmm_rate: readout.rate_Hz is {rate_Hz:g}; with cycles = {cycles:g} at most {most_Hz:g}
  Hz is possible
station_file.level: readout.level_V is {level_V:g}; a value in (0, 20] was expected
station_file.known: {name} is {value}; known are {known}
station_file.one_channel: readout.channels is {channels}; kind {kind} reads one channel
station_file.positive: {name} is {value:g}; a number above 0 was expected

# What was read, on the disk.
spool.done: done
spool.cut_off: cut off
spool.aborted: aborted: {why}
file.closed: {path}: cannot be written: {error}; make room, nothing moved
file.full: {path}: samples cannot be kept: {error}; see that the disk is there and has room, press
  again
file.unreadable: {path}: {error}
file.no_spool: {path}: is no spool of softcal; nothing was changed
system.full: No space left on device
system.denied: Permission denied

# What the self-test looks at, what it found, and what to do.
check.stream: stream
check.reading: reading
check.noise: noise
check.rate: rate
check.drift: clock drift
check.latency: latency
check.unseen: without a load cell
check.zero: zero
check.homing_moving: homing and moving
check.homing: homing
check.travel: travel
check.return: out and back
check.setting: setting
check.safe_speed: safe speed
check.unit_seconds: seconds a unit
check.shorter: would be shorter
check.runs_on: runs on when the host dies
check.ran_on: ran on when left alone
found.samples: samples: {count}
found.reading: {values} {unit}
found.noise: {noise:.2g} {unit}
found.drift: {drift_ppm} ppm, give or take {doubt_ppm}
found.latency: median {middle_ms:.1f} ms, largest {most_ms:.1f} ms
found.switch: found its switch
found.unseen: no force is limited; steps per mm that are wrong, a stiff thing under the stage and a unit
  that is pressed too hard are not seen
found.travel: {travel_mm:g} mm, {speed_mm_s:g} mm/s
found.return: {way_mm:.3g} mm in {took_s:.2f} s, off by {error_mm:+.3f} mm
found.safe_speed: a stop ends below {ceiling_N:g} N (up to {free_mm_s:.2g} mm/s where nothing was
  felt, {unknown_mm_s:.2g} mm/s where the unit was not pressed yet)
found.unit_seconds: at most {all_s:.0f} s after the first one, {press_s:.0f} s of pressing and
  {feel_s:.0f} s of the slow press before it ({profile}, stiffest_N_mm = {stiffest_N_mm:g})
found.shorter: {all_s:.0f} s with {key} = {value:g}, where that is true
found.runs_on: it runs on for {on_s:.2f} s at most (at {speed_mm_s:g} mm/s {way_mm:.2g} mm, no
  deeper than felt; where nothing was felt, at {slow_mm_s:.2g} mm/s {slow_mm:.2g} mm and
  {worst_N:.1f} N)
found.ran_on: {way_mm:.2g} mm at {speed_mm_s:.2g} mm/s, {most_mm:.2g} mm at most
found.rate: {rate_Hz:.4g} Hz
found.zero: {zero_N:+.3f} N
found.failed: failed
cure.no_stream: no stream; check cable, supply, firmware
cure.rate: {rate_Hz:g} Hz were expected; check the firmware, or ask the engineer to correct rate_Hz
  in the station file
cure.clock: clock far off; check its firmware
cure.zero: at most {allowed_N:g} N; unload the cell, then zero it
cure.ran_on: the controller goes further than it was told; do not press with it, check its firmware
cure.return: it does not come back; check screws, belt and steps per mm

# What the gate looks at, and what it says.
gate.no_certificate: the load cell has no certificate on file; import it or type it in
gate.ended: the load cell's certificate {number} ended on {day}; have it calibrated
gate.valid: {number}, valid until {day}
gate.reaches: the profile reaches {force_N:g} N, the certificate ends at {most_N:g} N
gate.too_far: {reaches}; use another cell or a lower force limit
gate.warms: the load cell warms up for {minutes} more min; wait
gate.warm: the load cell is on for {minutes} min
gate.zero_moved: the load cell's zero moved by {moved_N:.3g} N, {limit_N:g} N is allowed
gate.zero_fault: {why}; check its mounting, then run the self-test
gate.zero: {moved_N:+.3f} N over the newest run, {limit_N:g} N is allowed
gate.homing_fault: the stage could not be homed ({why}); check its switch, then run the self-test
gate.homes: the next run homes first
gate.no_golden: no golden unit was pressed in this shift; press one
gate.golden_bad: golden unit {serial} is outside its control limits; units since the last good check
  are held back; call the engineer
gate.golden: {serial} within its limits at {at}
gate.needs_reason: an override needs a reason; the gate is as it was
gate.homed: homed
gate.name.certificate: certificate
gate.name.force_range: force range
gate.name.warm_up: warm-up
gate.name.zero_return: zero return
gate.name.homing: homing
gate.name.golden: golden unit
gate.name.qualification: qualification
gate.no_qualification: the station was never qualified; qualify it on a stiff spring
gate.not_qualified: the station did not pass its qualification; mend what its page names, qualify it again
gate.qualified: passed, valid until {day}
gate.qualification_ended: the qualification ended on {day}; qualify the station again
gate.qualified_ahead: a clock that was ahead stamped the qualification (valid until {day}); qualify the station again
golden.good: golden unit within its limits
golden.held: quarantined: {serials}
golden.own_limit: its control limit
golden.lot_limit: the limit of its lot
golden.error: error {error:.3g} {unit} is above {what}, {limit:.3g} {unit}
golden.none: no unit

# Control charts.
chart.few: too few values; a control chart needs at least 8 to find its limits (values: {count})
chart.no_limit: capability needs a minimum or a maximum
chart.limits_crossed: minimum {minimum:g} is not below maximum {maximum:g}
chart.not_a_number: value {value} of the control chart is not a number
chart.capability.few: too few values to state capability (values: {count}, needed: {least})
chart.unstable: the process is not stable ({rule}, value {number}); find the cause first, then state
  capability
chart.flat: all values are equal; a process without spread has no capability
chart.rule.1: a point beyond 3 sigma
chart.rule.2: 9 points in a row on one side
chart.rule.3: 6 points in a row rising or falling
chart.rule.4: 14 points in a row alternating
chart.rule.5: 2 of 3 points beyond 2 sigma on one side
chart.rule.6: 4 of 5 points beyond 1 sigma on one side
chart.rule.7: 15 points in a row within 1 sigma
chart.rule.8: 8 points in a row beyond 1 sigma on both sides

# Known loads at the line.
load.wanted: recorded; the known loads are read next (loads: {of})
load.read: load {step} of {of} was read: {level:.5g}
load.unsteady: the output did not stand still while it was read, so it was not taken; read it again
  (it moved by {drift:.1%} of its range and scattered by {spread:.1%})
load.unloaded: the output is the same as without a load, so it was not taken; put the load on, then
  read again ({level:.5g})
load.same: the output is the same as under the load before, so it was not taken; change the load,
  then read again ({level:.5g})
load.contradict: the known loads do not fit together: {why} (loads: {of})
load.lost: unit {serial}: this load is not due; nothing was read; scan the unit and press it again
load.no_step: an order to read a load names none: {told}; order it at the line's screen
load.several: several units were pressed at once, and a known load lies on one; nothing was kept;
  take the loads out of the rules of the lot (units: {count})
load.uncertain: the load {value:g} {unit} is not known well enough; nothing was pressed; take a
  better weight (U = {expanded:.3g} {unit}, at most {most:.3g} {unit} is allowed)
load.negative: a load of {value:g}; a number of 0 or more was expected
load.bad_uncertainty: the uncertainty of a load is {value:g}; a number of 0 or more was expected
load.too_many: too many loads: {count}; use {most} or fewer
load.twice: the load {value:g} stands there twice; state each load once
rig.moves: the stage moves; nothing was read; read again once it stands

# An order, a run and the service.
run.interrupted: the station's service was started again; press the unit again
run.defect: a defect of softcal ended this run ({kind}); the details are in its log, press again
run.in_progress: a run is in progress; nothing to acknowledge
run.stopping: the run is being stopped
run.cancelled: cancelled before it began
run.none: nothing was running
run.opened: the gate is open for this shift; the reason is in the audit trail
run.no_lot: unit {serial}: which lot does it belong to? the order names none; nothing moved
run.wrong_kind: the source unit of lot {lot} is {source}; {serial} was ordered as {kind}; nothing
  moved
run.no_network: recorded; lot {lot} has no shared network yet, so the unit is not judged; press its
  source unit, or train one
run.trained: source recorded, shared network trained (error {rmse:.3g} {unit} on parts it was not
  trained on)
run.epoch: epoch {epoch} of at most {most}, error {error:.3g}
run.bare_network: network {network}: its source recording has no reference; train it again
run.acknowledged: acknowledged
fault.real: faults can be ordered on a simulated station only; nothing was done
fault.unknown: fault {name} is unknown; known: {known}
fault.in_phase: {name}: comes while {phase}
fault.next: {name}: comes with the next run
station.served: station {station} is served by {process}; stop that one first
station.lost: {why}; this service was silent too long and has given up
station.taken: station {station} was taken by another process in this moment; stop that one first
station.busy: station {station} has a run that is not over ({what}, {state}); wait for it or stop it
line.no_station: no station is chosen at this screen; the scan was not taken
line.other_screens: other screens of this line scanned at the same time; the scan was not taken,
  scan again

# What the registry knows by name.
name.windows: serial {serial}: Windows cannot have a file of this name; give another serial
name.serial: serial {serial}: 1 to 64 letters, digits, '.', '-' or '_' are allowed, starting with a
  letter or digit, without '..'; give another serial
name.long: serial {serial}: it is too long (characters: {count}, in the name of a file: {length}); at
  most 64 and {max_length} are allowed; give a shorter serial
name.character: serial {serial}: {character} is not allowed; letters, digits, '.', '-' and '_' are;
  give another serial
name.twice: serial {serial} is given by {files}; upper and lower case do not tell units apart; keep
  one file, or give one of them another serial
name.lot: lot id {lot}: 1 to 64 letters, digits, spaces, '.', '-', '+' or '_' are allowed
name.no_order: order {order} is not in the registry
name.no_such_lot: lot {lot} is not in the registry; it holds {known}
name.no_such_serial: serial {serial} is not in the registry; it holds {known}

# People.
account.no_code: this is not the code that the server printed; nothing was made
account.first_is_there: there is an account already; sign in, or ask whoever has it
account.may_not: {role} may not do this; sign in as {roles}; nothing was changed
account.pins_differ: the two PINs differ; type the same one twice
account.pin_easy: this PIN is among the first that anybody would guess; choose another one
account.no_name: a person needs a name
account.role: role {role} is none of {known}
account.pin_short: a PIN is made of digits only, at least {digits} of them
account.changed: {name} was changed by somebody else (version {found}, not {version}); look again
  and decide
account.needs_pin: {name} is new and needs a PIN
account.locked: too many wrong PINs; wait {minutes} min
account.wrong_pin: name or PIN is wrong
account.inactive: this person may no longer sign in

# Several reasons in the place of one.
and: {first}; {rest}
""")
