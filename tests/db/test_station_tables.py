"""Certificates hold on their days only, and golden runs keep their order."""

from datetime import UTC, date, datetime

import pytest

from softcal.core.errors import InputError
from softcal.db.entries import CellCertificate, GoldenRun

OLD = CellCertificate("C1", "K-1", "lab", date(2025, 1, 1), date(2026, 1, 1), 50.0, 0.02, b"%PDF-1.4 first")
NEW = CellCertificate("C1", "K-2", "lab", date(2025, 12, 1), date(2026, 12, 1), 50.0, 0.01)


def test_the_newest_certificate_that_holds_on_the_day_counts(registry):
    registry.stations.add_certificate(OLD)
    registry.stations.add_certificate(NEW)
    assert registry.stations.certificates("C1") == [OLD, NEW]
    assert registry.stations.certificate("C1", date(2025, 6, 1)) == OLD
    assert registry.stations.certificate("C1", date(2025, 12, 24)) == NEW
    assert registry.stations.certificate("C1", date(2026, 12, 1)) is None
    assert registry.stations.certificate("C2", date(2025, 6, 1)) is None


def test_the_same_certificate_twice_is_one_and_another_of_that_day_is_refused(registry):
    registry.stations.add_certificate(OLD)
    registry.stations.add_certificate(OLD)
    with pytest.raises(InputError, match="K-1"):
        registry.stations.add_certificate(CellCertificate("C1", "K-9", "x", OLD.issued_on, OLD.due_on, 50.0, 0.02))
    assert len(registry.trail.rows()) == 1


@pytest.mark.parametrize("change", [{"due_on": date(2025, 1, 1)}, {"capacity_N": 0.0}, {"uncertainty_N": float("nan")}])
def test_a_senseless_certificate_cannot_be_made(change):
    with pytest.raises(InputError, match="K-1"):
        CellCertificate(**vars(OLD) | change)


def test_golden_runs_come_back_in_order(registry):
    runs = [
        GoldenRun("s1", "L1", "G1", datetime(2026, 5, day, tzinfo=UTC), 0.01 * day, "N", day < 3, ("drift",), "kim")
        for day in (1, 2, 3)
    ]
    for run in reversed(runs):
        registry.stations.add_golden_run(run)
    assert registry.stations.golden_runs("s1") == runs and registry.stations.golden_runs("s2") == []
    assert registry.stations.golden_runs(since=datetime(2026, 5, 2, tzinfo=UTC)) == runs[1:]
