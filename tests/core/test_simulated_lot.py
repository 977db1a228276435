"""What the line does to a simulated lot's recordings, and never to its audits."""

import numpy as np
from common.planted import LineEffects

from softcal.core.simulated_lot import SHIFTS, LotDesign, simulate_lot

SHORT = {"good": 4, "source_s": 60.0, "unit_s": 20.0, "audit_s": 20.0, "has_stage": True}


def test_no_effect_of_the_line_changes_nothing():
    plain, with_no_effects = (
        simulate_lot(3, LotDesign(**SHORT)),
        simulate_lot(3, LotDesign(**SHORT, line=LineEffects())),
    )
    assert [u.recording.sha256 for u in plain.units] == [u.recording.sha256 for u in with_no_effects.units]


def test_a_day_is_one_gain_and_zero_for_all_units_and_spares_the_audits():
    plain = simulate_lot(3, LotDesign(**SHORT))
    day = simulate_lot(3, LotDesign(**SHORT, line=LineEffects(day_gain=0.08, day_zero=0.03)))
    lines = [np.polyfit(p.recording.output, d.recording.output, 1) for p, d in zip(plain.units, day.units, strict=True)]
    assert np.allclose(lines, lines[0], rtol=1e-9) and abs(lines[0][0] - 1) > 1e-3
    assert [u.audit.sha256 for u in plain.units] == [u.audit.sha256 for u in day.units]
    assert plain.source.sha256 == day.source.sha256


def test_a_spread_of_the_load_reaches_the_recordings_alone():
    spread_lot = simulate_lot(5, LotDesign(**SHORT, line=LineEffects(load_spread=0.12)))
    peaks = [(np.ptp(u.recording.output), np.ptp(u.audit.unlabelled.output)) for u in spread_lot.units]
    assert np.std([recorded / audited for recorded, audited in peaks]) > 0.02


def test_programmes_outside_the_shifts_press_as_their_names_say():
    ranges = {}
    for name in ("own programme", "below half"):
        assert name not in SHIFTS
        lot = simulate_lot(2, LotDesign(**SHORT, shift=name))
        ranges[name] = max(float(u.recording.stage_mm.max()) for u in lot.units) / 3.5
    assert ranges["below half"] <= 0.5 < 0.9 < ranges["own programme"]
