"""An audit counts as drawn where the draw came first; papers say how many were, and how many were not."""

from dataclasses import replace

from softcal.app.calibration.audit import audited_sample, draw_plan
from softcal.app.calibration.release import read_lot_status
from softcal.app.export.certificates.lot_statement import build_lot_statement
from softcal.app.registry.lot_recordings import newest_audits, target_serials
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.recording import LabelledRecording
from softcal.db.connection import open_registry


def test_only_what_was_measured_after_the_draw_was_drawn_before_it_was_measured(calibrated):
    with open_registry(calibrated) as registry:
        audits = newest_audits(registry, "small")
        none = audited_sample(registry, "small")
        assert none.drawn_at is None and none.without_draw == len(audits) == 3
        plan = draw_plan(registry, "small", AuditConfig(random=2, doubtful=0)).plan
        chosen = audited_sample(registry, "small")
        assert (chosen.drawn, chosen.since, chosen.before, chosen.without_draw) == (2, 0, 2, 1)
        # Measured again since: another recording, which the registry sees for the first time now.
        (first, _) = plan.random
        old = registry.recordings.get(audits[first].sha256)
        assert isinstance(old, LabelledRecording)
        registry.recordings.add("small", replace(old, reference=old.reference + 0.001), "audit")
        # The very file that was there before the draw, brought again, is no newer measurement.
        registry.recordings.add("small", registry.recordings.get(audits[plan.random[1]].sha256), "audit")
        sample = audited_sample(registry, "small")
        assert (sample.since, sample.before, sample.without_draw) == (1, 1, 1)
        status = read_lot_status(registry, "small")
        assert build_lot_statement(registry, status, status.decided).sample == sample


def test_a_second_draw_from_fewer_units_is_counted_among_the_units_of_the_lot(calibrated):
    with open_registry(calibrated) as registry:
        targets = len(target_serials(registry, "small"))
        first = draw_plan(registry, "small", AuditConfig(random=2, doubtful=0)).plan
        second = draw_plan(registry, "small", AuditConfig(random=9, doubtful=2), reason="the others, too").plan
        assert second.population < first.population
        sample = audited_sample(registry, "small")
        assert sample.drawn == len({*first.random, *second.random}) > second.population
        assert sample.population == targets >= sample.drawn
