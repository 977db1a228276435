"""The audit trail: who did what and why, filtered, searched, taken along. Newest first."""

from datetime import UTC, date, datetime, time
from functools import partial

import streamlit as st

from softcal.app.ui.actions import csv_of, download
from softcal.app.ui.desk import empty, in_one_language, instant, named, say, zone
from softcal.app.ui.panels import table_to_choose
from softcal.app.ui.server_memory import registry
from softcal.app.views.audit_trail import HEADINGS, Entry, TrailFilter, trail

NEWEST, PAGE = 5000, 200


def draw() -> None:
    is_whole = bool(st.session_state.get("trail-whole"))
    rows = registry().trail.newest(10**9 if is_whole else NEWEST)
    if not rows:
        empty("audit.none", say("empty.lots.how"))
        return
    entries = trail(rows, say)
    first, second, third, fourth, fifth = st.columns([3, 2, 3, 2, 2])
    text = str(first.text_input(say("trail.find"), key="trail-find", icon=":material/search:") or "")
    everybody, unset = sorted({entry.row.actor for entry in entries}), say("choose.all")
    actors = second.multiselect(say("column.actor"), everybody, key="trail-actor", placeholder=unset)
    sections = third.multiselect(
        say("trail.section"), HEADINGS, format_func=named("trail.section"), key="trail-section", placeholder=unset
    )
    since = _midnight(fourth.date_input(say("trail.since"), value=None, key="trail-since"), time.min)
    until = _midnight(fifth.date_input(say("trail.until"), value=None, key="trail-until"), time.max)
    wanted = TrailFilter(text, tuple(actors), tuple(sections), since, until)

    found = [entry for entry in entries if wanted.takes(entry)]
    st.caption(say("trail.count", shown=min(len(found), PAGE), found=len(found), of=len(entries)))
    if len(entries) >= NEWEST and not is_whole:
        st.toggle(say("trail.whole", newest=NEWEST), key="trail-whole")
    if not found:
        st.caption(say("trail.none"))
        return
    chosen = table_to_choose([_row(entry) for entry in found[:PAGE]], "trail")
    exported = ("audit_trail", ("audit_trail",), {"rows": len(found)})
    download(say("trail.export"), "audit-trail.csv", partial(_csv, found), "trail-export", exported=exported)
    if chosen is None:
        return
    # The row as it is kept: for who checks the chain itself.
    row = found[chosen].row
    with st.container(border=True):
        st.markdown(f"**{say('trail.row')}**")
        st.code(
            f"{row.origin} #{row.seq}  {row.action} {row.entity} {row.key}\n"
            f"before: {row.before or '–'}\nafter:  {row.after or '–'}\n"
            f"hash: {row.hash}\nafter the row with: {row.prev_hash}",
            language=None,
            wrap_lines=True,
        )


def _midnight(day: date | None, at: time) -> datetime | None:
    return None if day is None else datetime.combine(day, at, zone()).astimezone(UTC)


def _row(entry: Entry) -> dict[str, object]:
    return {
        say("column.made"): instant(entry.row.at),
        say("column.actor"): entry.row.actor,
        say("trail.what"): entry.what,
        say("trail.changes"): entry.changed,
        say("column.reason"): entry.row.reason,
    }


def _csv(found: list[Entry]) -> bytes:
    with in_one_language():
        return csv_of([_row(entry) for entry in found])
