"""The known loads of a lot: what was read under which load, and a way to bring more."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import streamlit as st

from softcal.app.files.anchors import read_anchors
from softcal.app.registry.known_loads import known_loads, store_loads
from softcal.app.registry.lot_recordings import source_recording
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import finish, say_finished
from softcal.app.ui.components.job_panel import awaits_calibration, begin_job
from softcal.app.ui.components.lot_upload import dropped_files, forget_files
from softcal.app.ui.desk import in_words, instant, say
from softcal.app.ui.panels import go_to, has_units, table, unit_link
from softcal.app.ui.server_memory import registry
from softcal.core.errors import InputError
from softcal.core.lot import Lot, UnitKey
from softcal.core.maps.anchors import check_loads
from softcal.core.maps.interface import Anchors
from softcal.core.unit.method import Method

ASKED, ACTION = "known_loads", "set_up"


def draw_known_loads(lot_id: str) -> None:
    lot = registry().lots.get(lot_id)
    newest = {entry.serial: entry.sha256 for entry in registry().recordings.of_lot(lot_id, kind="unit")}
    # A unit that was pressed has loads before it has a result.
    if not newest and not has_units(lot_id):
        return
    st.markdown(say("known_loads.what"))
    rows = [
        {
            say("column.serial"): unit_link(UnitKey(lot_id, one.serial)),
            say("known_loads.loads", unit=lot.reference_unit): ", ".join(f"{x:.5g}" for x in one.loads.reference),
            say("known_loads.outputs", unit=lot.output_unit): ", ".join(f"{x:.5g}" for x in one.loads.output),
            say("known_loads.where"): say(f"known_loads.where.{one.where}"),
            say("known_loads.newest"): say(
                "trail.yes" if newest.get(one.serial) == one.recording_sha256 else "trail.no"
            ),
            say("column.made"): instant(one.at),
            say("column.actor"): one.actor,
        }
        for one in reversed(list(known_loads(registry(), lot_id).values()))
    ]
    table(rows, say("known_loads.none"))
    st.caption(say("known_loads.line"))
    if allows("set_limit"):
        if st.button(say("known_loads.to_rules"), icon=":material/arrow_forward:", key="known-loads-rules"):
            go_to("lot", lot=lot_id, tab="limits")
    if not allows(ACTION):
        return
    with st.container(border=True):
        st.markdown(f"## {say('known_loads.bring')}")
        if awaits_calibration(ASKED, lot_id):
            return
        say_finished(ASKED)
        st.caption(say("known_loads.bring.how"))
        files = dropped_files(ASKED)
        if not files:
            return
        taken, refused = _looked_at(lot, files, newest)
        if refused:
            table(
                [{say("column.serial"): serial, say("column.reasons"): why or None} for serial, why in refused.items()]
            )
        label = say("known_loads.take", count=len(taken))
        if st.button(label, type="primary", disabled=not taken, key="known-loads-take"):
            permit(ACTION)
            loads = {newest[serial]: (serial, one) for serial, one in taken.items()}
            is_new = store_loads(registry(), lot_id, loads, "page", actor=actor())
            forget_files(ASKED)
            if not is_new:
                finish(ASKED, say("known_loads.no_change"))
            st.session_state[ASKED] = begin_job("calibrate", ACTION, lot=lot_id)
            st.rerun()


def _looked_at(lot: Lot, files: Sequence[Path], newest: Mapping[str, str]) -> tuple[dict[str, Anchors], dict[str, str]]:
    """Return the loads by serial that can be taken, and why others are refused."""
    units = [unit.serial for unit in registry().lots.units(lot.id) if unit.role == "target"]
    state = registry().networks.released(lot.id)
    source = None if state is None else source_recording(registry(), state.network.id)
    taken: dict[str, Anchors] = {}
    refused: dict[str, str] = {}
    for file in files:
        try:
            anchors = read_anchors(file, units)
        except InputError as error:
            refused[file.name] = in_words(str(error).replace(f"{file}: ", ""))
            continue
        for serial, loads in anchors.items():
            try:
                if source is not None:
                    check_loads(source, loads, "nothing was kept", Method().map.anchors)
            except InputError as error:
                refused[serial] = in_words(error)
                continue
            if serial in newest:
                taken[serial] = loads
            else:
                refused[serial] = say("known_loads.refused.recording")
    return taken, refused
