"""The limit of a lot whose stated one was taken back: the source's own error gives it."""

import pytest

from softcal.app.calibration.redecision import redecide
from softcal.app.registry.limit import lot_limit
from softcal.app.registry.lot_recordings import source_model
from softcal.core.unit.method import Method
from softcal.db.connection import open_registry


def test_a_limit_that_was_taken_back_leaves_that_of_the_source(calibrated):
    with open_registry(calibrated) as registry:
        (lot_id,) = registry.lots.ids()
        registry.lots.set_limit(lot_id, None, reason="taken back")
        redecide(registry, [lot_id])
        limit = lot_limit(registry, lot_id)
        targets = [unit for unit in registry.lots.units(lot_id) if unit.role == "target" and unit.revision is not None]
        states = [registry.calibrations.get(unit.serial, lot_id=lot_id).state for unit in targets]
        source = source_model(registry, states[0].fit.network_id, Method())
    assert not limit.is_stated and {state.limit for state in states} == {limit}
    assert limit.maximum_rmse == pytest.approx(Method().decision.default_factor * source.held_out_rmse)
    assert not any(state.is_released for state in states)
