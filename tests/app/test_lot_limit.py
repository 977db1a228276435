"""The limit of a lot that states none, whatever its calibrations kept of theirs."""

from dataclasses import replace

import pytest

from softcal.app.batch.judging import judge_again
from softcal.app.registry.limit import lot_limit
from softcal.core.unit.judging import LIMIT_EVIDENCE
from softcal.db.connection import open_registry
from softcal.db.truth.in_use import ORIGIN, RMSE


@pytest.mark.parametrize("lost", [LIMIT_EVIDENCE, ("limit_origin",), ("limit_rmse",), ()])
def test_a_record_that_kept_no_limit_gives_that_of_its_source(calibrated, lost):
    """Older versions kept no limit with a calibration, or not where it came from."""
    with open_registry(calibrated) as registry:
        (lot_id,) = registry.lots.ids()
        registry.lots.set_limit(lot_id, None, reason="taken back")
        judge_again(registry, [lot_id])
        kept = lot_limit(registry, lot_id)
        for unit in registry.lots.units(lot_id):
            if unit.role == "target" and unit.revision is not None:
                record = registry.calibrations.get(unit.serial, lot_id=lot_id).record
                evidence = {name: value for name, value in record.evidence.items() if name not in lost}
                older = replace(record, evidence=evidence, input_sha256="0" * 64)
                registry.calibrations.add(lot_id, older)
                assert registry.calibrations.get(unit.serial, lot_id=lot_id).record.evidence == evidence
        again = lot_limit(registry, lot_id)
    assert not again.is_stated and str(again.origin) == str(kept.origin)
    assert again.maximum_rmse == pytest.approx(kept.maximum_rmse)


def test_the_registry_looks_for_the_names_that_a_calibration_keeps():
    assert (RMSE, ORIGIN) == LIMIT_EVIDENCE[:2]
