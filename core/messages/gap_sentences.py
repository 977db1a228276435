"""What a diagnosis says of the place of a gap and of the next run, in English: one sentence a code.

Names of effects, channels, maps and profiles are values: `app/texts` has them.
"""

from softcal.core.messages.sentences import sentences

GAP_SENTENCES = sentences("""
# In which samples a gap stands out.
gap.regime.everywhere: everywhere
gap.regime.loading: loading
gap.regime.unloading: unloading
gap.regime.hold: hold
gap.regime.no_contact: no contact
gap.regime.first_touch: first touch (lowest 15 % of the stroke)
gap.regime.high_load: high load (top 20 % of the stroke)
gap.regime.fast_motion: fast motion
gap.regime.start: start of the run (first quarter)
gap.regime.end: end of the run (last quarter)
gap.regime.run: run {run}
gap.regime.run_pressed: run {run} ({pressed})
gap.regime.low_level: low level (lowest fifth)
gap.regime.high_level: high level (highest fifth)
gap.regime.rising: rising
gap.regime.falling: falling
gap.regime.fast_change: fast change
gap.regime.still: standing still

# What was pressed: a name, and what it was made with.
gap.pressed: {profile}
gap.pressed.sized: {profile} {size}

# What is seen at a place.
gap.effect: {effect}
gap.map: {map}
gap.map.none: none
gap.seen.maps: relations that still do not fit, each fitted by itself: {maps}
gap.seen.effect: {effect}; {seen}
gap.seen.alias: or {alias}
gap.seen.energy: {share:.0%} of the gap's energy lies in this part of the run, {lift:.1f} x its
  share of time
gap.seen.energy_of_all: {share:.0%} of the gap's energy lies here, {lift:.1f} x its share of time
gap.seen.like: like {like}; {seen}
gap.seen.noise: {noise}; {seen}
gap.seen.left: {seen}; the known effects explain {share:.0%} of the gap that is not noise; none of
  them explains the rest
gap.seen.better: {seen}; the known effects explain {share:.0%} of the gap that is not noise, but
  less well than this
gap.seen.same_maps: as possible, by the same measurements
gap.seen.nearest: {causes} explains {share:.0%} of it
gap.seen.rest: a rest that no cause explains, {share:.0%} of the gap
gap.seen.no_candidate: no candidate explains any of it
gap.seen.tone: a tone in the {channel} ({frequency_Hz:.1f} Hz, {rms:.1f} x its noise)
gap.seen.spikes: spikes in the output while little moves (samples: {count})
gap.seen.jitter: the output is noisier the faster it changes, so the times of its samples are not
  even

# Departures outside the catalogue.
gap.like.stiffness_in_time: a stiffness that drifts
gap.like.stiffness_when_warm: a stiffness that follows the temperature
gap.like.sensitivity_in_time: a sensitivity that drifts
gap.like.sensitivity_when_warm: a sensitivity that follows the temperature
gap.like.offset_in_time: an output offset that drifts
gap.like.offset_when_warm: an output offset that follows the temperature
gap.like.cell_span_in_time: a cell whose span drifts
gap.like.cell_span_when_warm: a cell whose span follows the temperature
gap.like.cell_zero_when_warm: a cell whose zero follows the temperature
gap.like.cell_by_position: a cell that reads the position
gap.like.cell_late: a cell that reads late
gap.like.divider_when_warm: a divider resistor that follows the temperature
gap.alias.divider: the divider resistor's temperature coefficient with its sign reversed, since the
  divider shows only R/Rs

# What to press next, and why.
gap.next.separates: this run tells {causes} apart ({distance:.0f} x the noise, {minutes:.1f} min)
gap.next.separates_most: this run tells {causes} apart, except {others} of them ({distance:.0f} x
  the noise, {minutes:.1f} min)
gap.next.inseparable: no run of the list tells {causes} apart; {remedy}
gap.next.what_follows: press at several speeds with holds between; this shows whether the rest of
  the gap follows speed, time or load
gap.next.what_follows_unseen: press at several speeds with holds between; this shows whether the
  rest of the gap follows speed, time or load; record the stage position too, without which half of
  the chain is not seen
gap.rest: a rest that has its own law
gap.next.slow: no gap is seen here; slow creep, drift and ageing would show first in a long hold
gap.next.alias: {effect} may as well be {alias}; {advice}
gap.next.separated: these runs tell the causes apart; apply them to the twin
gap.next.name_rest: a rest has no name; ask the engineer for an effect that acts at the place where it stands out
gap.next.add_candidate: none of the effects explains the gap; ask the engineer to add one that acts
  at the place where the gap stands out
gap.next.no_gap: no gap is seen on these runs
gap.next.separated_here: these runs tell the causes apart
gap.next.no_experiments: {causes} fit equally well; give the simulator runs to choose among
gap.remedy.platen: measure the position of the platen itself
gap.remedy.climate: log the temperature of the sensor and the reference voltage
gap.remedy.usual: use a second load cell, or measure the channel with four wires
gap.advice.warm_dummy: read a dummy resistor for a minute while the electronics warm by a few K, and
  record temperature_C

# What the runs do not tell.
gap.told.own: {name} cannot be told: each run may have a {offset} of its own; {cure}
gap.told.beside: {name} cannot be told from {beside}; {cure}
gap.told.small: too little shows of {name} ({sigma:.1f} x the noise at its usual size); {cure}
gap.told.never: {name} does not show on these runs; {cure}
gap.told.alike: {one} and {other} look alike on these runs
gap.run: {profile}
gap.told.run: this run would tell: {runs}
gap.told.no_run: no run of the list would tell

# Lists.
gap.list: {first}, {rest}
gap.both: {first} and {rest}
gap.together: {first}+{rest}
""")
