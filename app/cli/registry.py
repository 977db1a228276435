"""`softcal registry`: the database with every unit's history."""

import argparse
import time
from functools import partial

from softcal.app.bootstrap import registry_url
from softcal.app.cli.confirm import NOT_CONFIRMED, RECALL_HEADER, may_do, withdraw_files
from softcal.app.cli.options import (
    FILE,
    actions_of,
    add_shared,
    answer,
    echo_unused_input,
    echo_written_url,
    registry_of,
)
from softcal.app.output import echo, escape_controls, print_reasons, print_table
from softcal.core.errors import RegistryError

EXAMPLES = """examples:
  softcal registry list --lot lot-1
  softcal registry history --serial A17
  softcal registry rollback --serial A17 --to 2 --reason "remounted, revision 3 was wrong"
  softcal registry verify
  softcal registry backup /backup/registry-2026-05-04.db
  softcal registry restore /backup/registry-2026-05-04.db --registry sqlite:///new.db
  softcal registry sync --with postgresql://line@db/softcal
  softcal registry grants --line line --manager quality --reader office | psql softcal
  softcal registry upgrade

The registry is an SQLite file or a PostgreSQL database:
  --registry sqlite:///relative.db, sqlite:////absolute/file.db or postgresql://USER@HOST/DATABASE
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Units, maps and who did what: append-only, with a chained audit trail."""
    action = actions_of(parser, shared=("registry", "json"), is_described=True)
    listing = action("list", "units with their newest verdict", _list)
    listing.add_argument("--lot", metavar="ID", help="only this lot")
    listing.add_argument("--verbose", action="store_true", help="all reasons of every unit; by default the first one")
    add_shared(listing, "csv")
    history = action("history", "every revision of a unit's map", _history)
    history.add_argument("--serial", required=True)
    add_shared(history, "lot", "csv")
    verify = action("verify", "check every stored byte, every row, the schema and the audit trail", _verify)
    verify.add_argument("--quick", action="store_true", help="leave out pages and blobs")
    verify.add_argument(
        "--against", action="append", default=[], **FILE,
        help="a backup, or audit.json of an export: nothing that it knows may be gone; may be repeated",
    )  # fmt: skip
    backup = action("backup", "write one consistent copy while the registry is in use", _backup)
    backup.add_argument("file", **FILE, help="new SQLite file")
    restore = action("restore", "fill an empty registry from a backup", _restore)
    restore.add_argument("file", **FILE, help="a backup")
    rollback = action("rollback", "bring an older revision back into use", _rollback)
    rollback.add_argument("--serial", required=True)
    add_shared(rollback, "lot")
    rollback.add_argument("--to", required=True, type=int, metavar="REVISION")
    rollback.add_argument("--origin", metavar="REGISTRY", help="who made it, where two registries made this revision")
    add_shared(rollback, "reason", "yes")
    recall = action("recall", "units whose files went out and no longer hold", _recall)
    recall.add_argument("--lot", metavar="ID", help="only this lot")
    add_shared(recall, "csv")
    sync = action("sync", "bring a station's registry and the line's together, both ways", _sync)
    sync.add_argument("--with", required=True, dest="other", metavar="URL", help="the other registry")
    grants = action("grants", "print the SQL that gives a PostgreSQL role what the line needs", _grants)
    grants.add_argument("--line", default="softcal_line", metavar="ROLE", help="may calibrate; default softcal_line")
    grants.add_argument(
        "--manager", default="softcal_manager", metavar="ROLE",
        help="may also set people, limits, rules and certificates; default softcal_manager",
    )  # fmt: skip
    grants.add_argument("--reader", default="softcal_reader", metavar="ROLE", help="may read; default softcal_reader")
    action("upgrade", "make the tables of this version in an empty database", _upgrade)


def _report_action(options: argparse.Namespace, action: str, line: str, **content: object) -> None:
    """Print the result of an action: as JSON on request, else as one line on standard output."""
    if answer(options, f"registry.{action}/1", content):
        print(line)


def _list(options: argparse.Namespace) -> None:
    from softcal.app.registry.listing import UNIT_HEADER, first_reasons, unit_json, unit_row
    from softcal.app.registry.same_recordings import same_recordings_of

    with registry_of(options) as registry:
        units = registry.lots.units(options.lot)
        remarks = same_recordings_of(registry, options.lot)
    content = {"units": [unit_json(unit) for unit in units], "remarks": [str(remark) for remark in remarks]}
    answer(options, "registry.list/1", content)
    print_table(UNIT_HEADER, [unit_row(unit) for unit in units], len(UNIT_HEADER) - (not options.verbose))
    if not options.verbose and "-" not in (options.json, options.csv):
        for subject, reasons in first_reasons(units):
            print_reasons(subject, reasons)
    echo_unused_input((), remarks)


def _history(options: argparse.Namespace) -> None:
    from softcal.app.registry.listing import HISTORY_HEADER, history_json, history_row

    with registry_of(options) as registry:
        lot_id = registry.calibrations.unit_key(options.serial, options.lot).lot_id
        (unit,) = registry.lots.units(lot_id, options.serial)
        revisions = registry.calibrations.history(options.serial, lot_id)
        proofs = registry.recordings.proof_methods(lot_id, options.serial)
    records = [history_json(stored, proofs) for stored in revisions]
    content = {"serial": options.serial, "lot": lot_id, "revisions": records}
    answer(options, "registry.history/1", content)
    print(f"unit {options.serial} of lot {lot_id}")
    if revisions:
        print_table(HISTORY_HEADER, [history_row(stored) for stored in revisions])
        for method in sorted({method for method in proofs.values() if method}):
            print(f"pressed on a station, which proved its recordings by method {method[:12]}")
    else:
        print(escape_controls("; ".join(("no calibration yet", *map(str, unit.reasons)))))
    if unit.is_conflict:
        echo(f"conflict: {unit.reasons[0]}")


def _verify(options: argparse.Namespace) -> None:
    from softcal.app.registry.maintenance import verify

    start_s = time.monotonic()

    def on_step(name: str) -> None:
        if not options.quick:
            echo(f"{time.monotonic() - start_s:5.1f} s  checking {name}")

    with registry_of(options) as registry:
        verified = verify(registry, is_quick=options.quick, files=options.against, on_step=on_step)
    content = {"faults": list(verified.faults), "audit_rows": verified.audit_rows, "heads": verified.heads}
    content["is_quick"] = options.quick
    if not verified.faults:
        ends = ", ".join(f"{origin} {seq} {sha256}" for origin, (seq, sha256) in verified.heads.items())
        summary = "what was looked at is whole" if options.quick else "the registry is whole"
        line = f"{summary}: {verified.audit_rows} rows in the audit trail, ending with {ends or 'nothing'}"
        _report_action(options, "verify", line, **content)
        return
    for fault in verified.faults:
        echo(fault)
    answer(options, "registry.verify/1", content)
    raise RegistryError(f"{len(verified.faults)} faults; keep the file as evidence and go back to a backup")


def _backup(options: argparse.Namespace) -> None:
    from softcal.app.registry.maintenance import back_up_registry

    with registry_of(options) as registry:
        back_up_registry(registry, options.file)
    size_MB = options.file.stat().st_size / 1e6
    line = f"{options.file}: {size_MB:.1f} MB"
    _report_action(options, "backup", line, file=str(options.file), size_MB=size_MB)


def _restore(options: argparse.Namespace) -> None:
    from softcal.db.maintenance.backup import restore

    restore(options.file, registry_url(options.registry))
    echo_written_url(registry_url(options.registry))
    line = f"restored from {options.file}; every byte of it was checked"
    _report_action(options, "restore", line, file=str(options.file))


def _rollback(options: argparse.Namespace) -> int:
    from softcal.app.calibration.release import roll_back

    with registry_of(options) as registry:
        which = {"lot_id": options.lot, "origin": options.origin}
        # Whatever is asked for, an unknown unit is said before anything else.
        lot_id = registry.calibrations.get(options.serial, options.to, **which).lot_id
        which["lot_id"] = lot_id
        act = partial(roll_back, registry, options.serial, options.to, reason=options.reason, **which)
        if not may_do(registry, lot_id, act, options.yes):
            return NOT_CONFIRMED
        revision = act()
        withdraw_files(registry, lot_id)
    line = f"{options.serial}: revision {revision} is in use, it repeats revision {options.to}"
    _report_action(options, "rollback", line, serial=options.serial, revision=revision, rolled_back_to=options.to)
    return 0


def _sync(options: argparse.Namespace) -> None:
    from softcal.app.calibration.redecision import redecide_stale
    from softcal.app.export.export import withdraw_recalled_files
    from softcal.app.registry.maintenance import synchronise_with

    with registry_of(options, create=True) as registry:
        report = synchronise_with(registry, options.other)
        redecide_stale(registry)
        withdraw_recalled_files(registry, registry.lots.ids())
    if report.sent:
        echo_written_url(options.other)
    for conflict in report.conflicts:
        echo(f"conflict: {conflict}")
    for clock in report.clocks:
        echo(f"clock: {clock}")
    line = f"sent {report.sent}, received {report.received} changes, {len(report.conflicts)} conflicts"
    content = {"conflicts": list(report.conflicts), "clocks": list(report.clocks)}
    _report_action(options, "sync", line, sent=report.sent, received=report.received, **content)


def _recall(options: argparse.Namespace) -> None:
    from softcal.app.registry.exported_files import list_recalls

    with registry_of(options) as registry:
        lots = registry.lots.ids() if options.lot is None else [registry.lots.get(options.lot).id]
        units = [one.to_json() for one in list_recalls(registry, lots)]
    if answer(options, "registry.recall/1", {"units": units}):
        names = ("lot", "serial", "revision", "place", "host", "verdict", "why")
        print_table(RECALL_HEADER, [[one[name] for name in names] for one in units])
        print(f"{len(units)} to recall")


def _grants(options: argparse.Namespace) -> None:
    from softcal.db.access.grants import grant_statements

    statements = grant_statements(options.line, options.reader, options.manager)
    _report_action(options, "grants", "\n".join(statements), sql=statements)


def _upgrade(options: argparse.Namespace) -> None:
    from softcal.app.registry.maintenance import upgrade
    from softcal.db.schema.tables import SCHEMA

    before = upgrade(registry_url(options.registry))
    line = f"the registry has schema {SCHEMA} already; nothing to do"
    if before is None:
        echo_written_url(registry_url(options.registry))
        line = f"the registry was made, with schema {SCHEMA}"
    _report_action(options, "upgrade", line, before=before, after=SCHEMA)
