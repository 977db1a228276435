"""`softcal lot fit`: map the units of a lot that were pressed by one load at once together."""

import argparse
from functools import partial

from softcal.app.cli.confirm import MAX_PRINTED, NOT_CONFIRMED, is_confirmed, print_changes
from softcal.app.cli.options import Action, add_shared, answer, lot_id_of, registry_of
from softcal.app.output import print_table
from softcal.core.errors import InputError


def add_fit(action: Action) -> None:
    """Add the action `fit`."""
    fit = action("fit", "map units that were pressed by one load at once together; take that back", _fit)
    fit.add_argument("lot", metavar="LOT", help="lot in the registry, or its folder")
    fit.add_argument("--withdraw", action="store_true", help="give every unit back the map of its own")
    fit.add_argument("--reason", default="", help="why; needed with --withdraw")
    add_shared(fit, "yes", "registry", "json")


def _fit(options: argparse.Namespace) -> int:
    """Print which maps a fit of the lot changes, ask, and make the lot fit."""
    from softcal.app.calibration.changes import preview
    from softcal.app.calibration.lot_fit import make_lot_fit, plan_lot_fit

    if options.withdraw and not options.reason.strip():
        raise InputError("say why the fit of the lot is taken back: --reason TEXT was expected; nothing was changed")
    lot_id, changes, is_done = lot_id_of(options.lot), None, False
    with registry_of(options) as registry:
        registry.lots.get(lot_id)
        plan = plan_lot_fit(registry, lot_id, is_withdrawal=options.withdraw)
        act = partial(make_lot_fit, registry, plan, reason=options.reason or "lot fit")
        if plan.states:
            changes = preview(registry, lot_id, act)
            if options.json != "-":
                rows = [
                    [s, one.fit.lot_fit and one.fit.lot_fit.units, one.forecast.rmse] for s, one in plan.states.items()
                ]
                print_table(("unit", "of units under one load", "forecast"), rows[:MAX_PRINTED])
                print(f"lot fit {plan.number} changes maps (units: {len(rows)})")
                print_changes(changes)
            if is_done := is_confirmed(options.yes):
                act()
    content = {"lot": lot_id, **plan.to_json(), "changes": changes and changes.to_json(), "is_done": is_done}
    if answer(options, "lot.fit/1", content):
        for reason in plan.outlier_messages:
            print(reason)
        if not plan.states:
            print(f"no map of lot {lot_id} changes")
    return 0 if is_done or not plan.states else NOT_CONFIRMED
