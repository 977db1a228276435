"""What a diagnosis says of the place of a gap and of the next run, in English: one sentence a code.

`core.words.reason` reads it. Names of effects, channels, maps and profiles are values: `app/texts` has them.
"""

from collections.abc import Mapping

GAP_SENTENCES: Mapping[str, str] = {
    # In which samples a gap stands out.
    "gap.regime.everywhere": "everywhere",
    "gap.regime.loading": "loading",
    "gap.regime.unloading": "unloading",
    "gap.regime.hold": "hold",
    "gap.regime.no_contact": "no contact",
    "gap.regime.first_touch": "first touch (lowest 15 % of the stroke)",
    "gap.regime.high_load": "high load (top 20 % of the stroke)",
    "gap.regime.fast_motion": "fast motion",
    "gap.regime.start": "start of the run (first quarter)",
    "gap.regime.end": "end of the run (last quarter)",
    "gap.regime.run": "run {run}",
    "gap.regime.run_pressed": "run {run} ({pressed})",
    "gap.regime.low_level": "low level (lowest fifth)",
    "gap.regime.high_level": "high level (highest fifth)",
    "gap.regime.rising": "rising",
    "gap.regime.falling": "falling",
    "gap.regime.fast_change": "fast change",
    "gap.regime.still": "standing still",
    # What was pressed: a name, and what it was made with.
    "gap.pressed": "{profile}",
    "gap.pressed.sized": "{profile} {size}",
    # What is seen at a place.
    "gap.effect": "{effect}",
    "gap.map": "{map}",
    "gap.map.none": "none",
    "gap.seen.maps": "maps refitted separately that do not close: {maps}",
    "gap.seen.effect": "{effect}; {seen}",
    "gap.seen.alias": "or {alias}",
    "gap.seen.energy": "{share:.0%} of the gap's energy in this regime, {lift:.1f} times its share of time",
    "gap.seen.energy_of_all": "{share:.0%} of the gap's energy, {lift:.1f} times its share of time",
    "gap.seen.like": "like {like}; {seen}",
    "gap.seen.noise": "{noise}; {seen}",
    "gap.seen.left": ("{seen}; the catalogue explains {share:.0%} of the structured gap, nothing in it the rest"),
    "gap.seen.better": ("{seen}; the catalogue explains {share:.0%} of the structured gap, but less well than this"),
    "gap.seen.same_maps": "possible by the same maps",
    "gap.seen.nearest": "{causes} explains {share:.0%} of it",
    "gap.seen.no_candidate": "no candidate explains any of it",
    "gap.seen.tone": "a tone of {frequency_Hz:.1f} Hz in the {channel}, {rms:.1f} times its noise",
    "gap.seen.spikes": "{count} samples of the output far off while little moves: spikes",
    "gap.seen.jitter": "the noise of the output grows with its slope: the instants jitter",
    # Departures outside the catalogue.
    "gap.like.stiffness_in_time": "a stiffness that drifts",
    "gap.like.stiffness_when_warm": "a stiffness that follows the temperature",
    "gap.like.sensitivity_in_time": "a sensitivity that drifts",
    "gap.like.sensitivity_when_warm": "a sensitivity that follows the temperature",
    "gap.like.offset_in_time": "an output offset that drifts",
    "gap.like.offset_when_warm": "an output offset that follows the temperature",
    "gap.like.cell_span_in_time": "a cell whose span drifts",
    "gap.like.cell_span_when_warm": "a cell whose span follows the temperature",
    "gap.like.cell_zero_when_warm": "a cell whose zero follows the temperature",
    "gap.like.cell_by_position": "a cell that reads the position",
    "gap.like.cell_late": "a cell that reads late",
    "gap.like.divider_when_warm": "a divider resistor that follows the temperature",
    "gap.alias.divider": (
        "the divider resistor's temperature coefficient, sign reversed: only R/Rs enters the divider"
    ),
    # What to press next, and why.
    "gap.next.separates": (
        "separates {causes} by {distance:.0f} standard deviations of the noise in {minutes:.1f} min"
    ),
    "gap.next.separates_most": (
        "separates {causes} (all but {others}) by {distance:.0f} standard deviations of the noise in {minutes:.1f} min"
    ),
    "gap.next.inseparable": "{causes} cannot be separated by any run of the menu; {remedy}",
    "gap.next.what_follows": "a rate sweep with holds shows whether what is left follows speed, time or load",
    "gap.next.what_follows_unseen": (
        "a rate sweep with holds shows whether what is left follows speed, time or load; log the stage position, "
        "without which half of the chain is not seen"
    ),
    "gap.next.slow": "no gap is visible here; slow creep, drift and ageing would show first in a long hold",
    "gap.next.alias": "{effect} may as well be {alias}; {advice}",
    "gap.next.separated": "the causes are separated on these runs; apply them to the twin",
    "gap.next.add_candidate": ("no candidate explains the gap; add one that acts where `where` says it stands out"),
    "gap.next.no_gap": "no gap is visible on these runs",
    "gap.next.separated_here": "the causes are separated on these runs",
    "gap.next.no_experiments": "{causes} fit alike; give the simulator experiments to choose among",
    "gap.remedy.platen": "measure the position of the platen itself",
    "gap.remedy.climate": "log the temperature of the sensor and the reference voltage",
    "gap.remedy.usual": "a second load cell or a four-wire measurement of the channel would",
    "gap.advice.warm_dummy": (
        "read a dummy resistor for a minute while the electronics warm by a few K, with temperature_C logged"
    ),
    # Lists.
    "gap.list": "{first}, {rest}",
    "gap.both": "{first} and {rest}",
    "gap.together": "{first}+{rest}",
}
