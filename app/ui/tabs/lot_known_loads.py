"""The known loads of a lot: what was read under which load, and a way to bring more."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import streamlit as st

from softcal.app.files.anchors import read_anchors
from softcal.app.registry.known_loads import known_loads, store_loads
from softcal.app.registry.lot_recordings import source_recording
from softcal.app.ui.account import actor, allows, permit
from softcal.app.ui.actions import finish, show_finished
from softcal.app.ui.components.job_panel import awaits_calibration, begin_job
from softcal.app.ui.components.lot_upload import dropped_files, forget_files
from softcal.app.ui.panels import go_to, has_units, table, unit_link
from softcal.app.ui.presentation import format_instant, localize, translate
from softcal.app.ui.server_cache import registry
from softcal.core.errors import InputError
from softcal.core.lot import Lot, UnitKey
from softcal.core.maps.anchors import check_loads
from softcal.core.maps.interface import Anchors
from softcal.core.unit.method import Method

JOB_KEY, ACTION = "known_loads", "set_up"


def draw_known_loads(lot_id: str) -> None:
    lot = registry().lots.get(lot_id)
    newest = {entry.serial: entry.sha256 for entry in registry().recordings.of_lot(lot_id, kind="unit")}
    # A unit that was pressed has loads before it has a result.
    if not newest and not has_units(lot_id):
        return
    st.markdown(translate("known_loads.what"))
    rows = [
        {
            translate("column.serial"): unit_link(UnitKey(lot_id, one.serial)),
            translate("known_loads.loads", unit=lot.reference_unit): ", ".join(f"{x:.5g}" for x in one.loads.reference),
            translate("known_loads.outputs", unit=lot.output_unit): ", ".join(f"{x:.5g}" for x in one.loads.output),
            translate("known_loads.where"): translate(f"known_loads.where.{one.where}"),
            translate("known_loads.newest"): translate(
                "trail.yes" if newest.get(one.serial) == one.recording_sha256 else "trail.no"
            ),
            translate("column.made"): format_instant(one.at),
            translate("column.actor"): one.actor,
        }
        for one in reversed(list(known_loads(registry(), lot_id).values()))
    ]
    table(rows, translate("known_loads.none"))
    st.caption(translate("known_loads.line"))
    if allows("set_limit"):
        if st.button(translate("known_loads.to_rules"), icon=":material/arrow_forward:", key="known-loads-rules"):
            go_to("lot", lot=lot_id, tab="limits")
    if not allows(ACTION):
        return
    with st.container(border=True):
        st.markdown(f"## {translate('known_loads.bring')}")
        if awaits_calibration(JOB_KEY, lot_id):
            return
        show_finished(JOB_KEY)
        st.caption(translate("known_loads.bring.how"))
        files = dropped_files(JOB_KEY)
        if not files:
            return
        accepted, refused = _read_loads(lot, files, newest)
        if refused:
            table(
                [
                    {translate("column.serial"): serial, translate("column.reasons"): reason or None}
                    for serial, reason in refused.items()
                ]
            )
        label = translate("known_loads.take", count=len(accepted))
        if st.button(label, type="primary", disabled=not accepted, key="known-loads-take"):
            permit(ACTION)
            loads = {newest[serial]: (serial, one) for serial, one in accepted.items()}
            is_new = store_loads(registry(), lot_id, loads, "page", actor=actor())
            forget_files(JOB_KEY)
            if not is_new:
                finish(JOB_KEY, translate("known_loads.no_change"))
            st.session_state[JOB_KEY] = begin_job("calibrate", ACTION, lot=lot_id)
            st.rerun()


def _read_loads(
    lot: Lot, files: Sequence[Path], newest: Mapping[str, str]
) -> tuple[dict[str, Anchors], dict[str, str]]:
    """Return the loads by serial that can be taken, and why others are refused."""
    units = [unit.serial for unit in registry().lots.units(lot.id) if unit.role == "target"]
    state = registry().networks.released(lot.id)
    source = None if state is None else source_recording(registry(), state.network.id)
    accepted: dict[str, Anchors] = {}
    refused: dict[str, str] = {}
    for file in files:
        try:
            anchors = read_anchors(file, units)
        except InputError as error:
            refused[file.name] = localize(str(error).replace(f"{file}: ", ""))
            continue
        for serial, loads in anchors.items():
            try:
                if source is not None:
                    check_loads(source, loads, "nothing was kept", Method().map.anchors)
            except InputError as error:
                refused[serial] = localize(error)
                continue
            if serial in newest:
                accepted[serial] = loads
            else:
                refused[serial] = translate("known_loads.refused.recording")
    return accepted, refused
