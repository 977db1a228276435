"""A lot of which something of every kind is declared."""

from datetime import date

import numpy as np

from softcal.app.calibration.audit import draw_plan
from softcal.app.calibration.lot_context import declare_family, declare_line_spread, declare_sources
from softcal.app.export.laboratory import Laboratory, Person, store_laboratory
from softcal.app.registry.exported_files import record_exported_files
from softcal.app.registry.golden import store_golden_runs
from softcal.app.registry.known_loads import store_loads
from softcal.app.registry.reference import declare_reference
from softcal.core.lot import UnitKey
from softcal.core.maps.interface import Anchors
from softcal.core.quality.audit_plan import AuditConfig
from softcal.core.unit.budget import Reference
from softcal.core.unit.line_spread import LineSpread

LOADS = Anchors(np.array([0.1, 0.2]), np.array([1.0, 2.0]))
CELL = Reference(cell="LC-1", certificate="D-K-1", due_on=date(2027, 1, 1), used_on=date(2026, 5, 1), uncertainty=0.02)


def declare_all(factory, labelled) -> None:
    """Declare something of every kind."""
    registry, lot_id = factory.registry, factory.lot_id
    factory.calibrate("U1")
    factory.calibrate("U2")
    declare_family(registry, lot_id, "affine")
    declare_line_spread(registry, lot_id, LineSpread(0.05, 0.01))
    declare_sources(registry, lot_id, [factory.network_id])
    declare_reference(registry, lot_id, CELL, labelled)
    store_loads(registry, lot_id, {"b" * 64: ("U1", LOADS)}, "file", actor="Erin")
    store_golden_runs(registry, lot_id, {"b" * 64: ("U1", "c" * 64)}, actor="Erin")
    draw_plan(registry, lot_id, AuditConfig(random=1, doubtful=1))
    confirmed = {"lot_id": lot_id, "serial": "U1", "output_sha256": "d" * 64, "doubt": {"code": "plain"}}
    registry.declarations.declare("confirmed_audits", confirmed, action="confirm", reason="pressed again")
    page = {"station": "line-1", "is_passed": True, "due_on": date(2026, 9, 1), "page": {"specimen": "spring"}}
    registry.declarations.declare("station_qualifications", page, action="qualify")
    statement = {"word": "pass", "nonconforming_upper": 0, "process_upper": 0.1, "error_ratio": 1.0}
    statement |= {
        "lot_id": lot_id,
        "text": "units checked: 2",
        "listed": [{"serial": "U1", "measured_rmse": 0.1, "is_failed": False}],
    }
    registry.declarations.declare("lot_statements", statement, action="judge")
    alert = {"kind": "yield", "lot_id": lot_id, "about": "", "is_open": True, "content": {"kind": "yield"}}
    record_exported_files(
        registry, {UnitKey(lot_id, "U1"): {"revision": 1, "map_sha256": "a" * 64, "verdict": "pass"}}, "/out"
    )
    store_laboratory(registry, Laboratory(person=Person("Kim")))
    registry.declarations.declare("alerts", alert, action="raise")
