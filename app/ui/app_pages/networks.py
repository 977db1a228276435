"""The shared networks of a lot: train one with the loss live, and compare networks and map families on its units."""

from softcal.app.ui.components.network_panels import comparison, training
from softcal.app.ui.components.network_release import release
from softcal.app.ui.desk import empty, errors_in_words, instant, registry, words
from softcal.app.ui.first_paint import rest_may_follow
from softcal.app.ui.panels import headline, lot_heading, table, told
from softcal.app.views.common import number
from softcal.app.views.network import NetworkRow, network_rows


def render() -> None:
    """Draw the page."""
    say = words()
    with errors_in_words():
        lots = {lot.id: lot for lot in registry().lots()}
        lot_id = lot_heading("networks", list(lots))
        if lot_id is None:
            return
        lot = lots[lot_id]
        rows = network_rows(registry(), lot.id)
        if rows:
            headline(_said(rows, lot.reference_unit))
        else:
            empty(say("networks.none"), say("networks.none.how"))
        if not rest_may_follow():
            return
        if rows:
            table(told([_row(row, lot.reference_unit) for row in rows]))
            release(lot, rows)
        training(lot)
        if rows:
            comparison(lot, rows)


def _said(rows: list[NetworkRow], unit: str) -> str:
    """Return which network is in use and how well it was trained, in one sentence."""
    used = next((row for row in rows if row.is_in_use), None)
    if used is None:
        return words()("networks.none_in_use", count=len(rows))
    error = number(used.validation_rmse, unit)
    return words()("networks.headline", network=used.id[:12], error=error, count=len(rows))


def _row(row: NetworkRow, unit: str) -> dict[str, object]:
    say = words()
    return {
        say("column.network"): row.id[:12],
        say("networks.state"): say("networks.in_use") if row.is_in_use else say(f"networks.state.{row.state}"),
        say("networks.decided"): row.decided,
        say("column.made"): instant(row.added_at),
        say("networks.hidden"): row.layers,
        say("networks.members"): row.members,
        say("networks.seed"): row.seed,
        say("networks.validation"): number(row.validation_rmse, unit),
        say("networks.epochs"): row.epochs,
        say("networks.train_s"): number(row.train_s, "s"),
        say("column.remark"): say("networks.stale") if row.is_stale else "",
    }
