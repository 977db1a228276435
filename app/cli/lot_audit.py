"""`softcal lot audit` and `softcal lot audit-plan`: draw units for audits, and import the audits."""

import argparse
from functools import partial
from pathlib import Path

from softcal.app.cli.confirm import NOT_CONFIRMED, may_do, print_changes, withdraw_files
from softcal.app.cli.options import (
    FILE,
    SAMPLE_RATE_HELP,
    TIME_COLUMN_HELP,
    Action,
    add_layout,
    add_shared,
    answer,
    echo_layout,
    echo_unused_input,
    lot_id_of,
    positive,
    registry_of,
    table_options,
    unused_json,
)
from softcal.app.output import echo, print_table, write_json
from softcal.core.errors import InputError

DONE, SOME_UNIT_NOT_PASSED = 0, 1

AUDIT_EXAMPLES = """examples:
  softcal lot audit lot-1 measured/*.csv         files called by their serials, columns t_s, output, reference
  softcal lot audit lot-1 EG-07.xlsx --time-column time --output-column V --reference-column N
  softcal lot audit lot-1 EG-07.csv --sample-rate 50        a table without a column of time
  softcal lot audit lot-1 EG-07.csv --measured-at 2026-01-31T14:30    when it was pressed, where the file has no dates
  softcal lot audit lot-1 --confirm EG-07 --reason "pressed again by hand, the same result"

An audit counts as drawn if it was measured after the draw.
LOT is a lot folder: the recordings go into its audit/, and `softcal batch LOT` judges by them. Or it is a lot of the
registry: they are kept there, and scored at once.
"""


def add_audits(action: Action) -> None:
    """Add the actions `audit` and `audit-plan`."""
    files_action = action(
        "audit",
        "bring labelled recordings of units into the lot; confirm one that is in doubt",
        _audit,
        epilog=AUDIT_EXAMPLES,
    )
    add = files_action.add_argument
    add("lot", metavar="LOT", help="lot folder, or a lot in the registry")
    add("files", nargs="*", **FILE, help="CSV, .xlsx or Parquet; of a folder, all")
    add("--output-column", default="output", help="default output; with * one unit per column")
    add("--reference-column", default="reference", help="column of the load cell; default reference")
    add("--time-column", metavar="NAME", help=TIME_COLUMN_HELP)
    add("--sample-rate", type=positive, metavar="HZ", help=SAMPLE_RATE_HELP)
    add(
        "--measured-at",
        metavar="WHEN",
        help="ISO date or date and time (local without a zone) of files without absolute stamps; default: when they "
        "are first seen. A date is its beginning",
    )
    add("--confirm", metavar="SERIAL", help="the audit of this unit is right in spite of the doubt")
    add("--reason", default="", help="why; needed with --confirm")
    add_layout(files_action)
    add_shared(files_action, "yes", "registry", "json")
    audit = action(
        "audit-plan",
        "draw which few units to check with the load cell; show how far the checks are and what they say",
        _audit_plan,
    )
    audit.add_argument("lot", metavar="ID", help="lot in the registry, or its folder")
    add_shared(audit, "registry", "json")
    for name, kind, text in (
        ("--doubtful", int, "units with the largest predicted error, beside the draw (default 0)"),
        ("--random", int, "units drawn from the other accepted ones, to speak for the unchecked (default 10)"),
        ("--seed", int, "drives the draw (default 0)"),
        ("--allowed-share", float, "share of nonconforming units the lot may hold (default 0.1)"),
    ):
        audit.add_argument(name, type=kind, metavar="N", help=text)
    audit.add_argument("--new", action="store_true", help="draw again although a plan stands; needs --reason")
    audit.add_argument("--reason", default="", help="why the plan is drawn again")


def _audit_plan(options: argparse.Namespace) -> int:
    """Draw the audit plan on the first call and store it; print its state on later calls."""
    from softcal.app.calibration.audit import AUDIT_HEADER, audit_json, audit_line, audit_rows, draw_plan, lot_audit
    from softcal.app.calibration.lot_context import lot_method
    from softcal.core.quality.acceptance import CRITERION_HEADER, criterion_rows
    from softcal.core.quality.audit_plan import AuditConfig
    from softcal.core.quality.qualification import small_lot

    lot_id = lot_id_of(options.lot)
    with registry_of(options) as registry:
        registry.lots.get(lot_id)
        audit = None if options.new else lot_audit(registry, lot_id)
        if audit is None:
            names = ("doubtful", "random", "seed", "allowed_share")
            choices = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
            audit = draw_plan(registry, lot_id, AuditConfig(**choices), reason=options.reason)
        units = sum(registry.pages.verdict_counts(lot_id).values())
        config = lot_method(registry, lot_id).release
    write_json(options.json, audit_json(audit))
    if options.json != "-":
        print_table(AUDIT_HEADER, audit_rows(audit))
        print(audit_line(audit))
        if small := small_lot(units, config):
            print(f"no promise by sample: {small}")
        else:
            print_table(CRITERION_HEADER, criterion_rows(config, units))
    return SOME_UNIT_NOT_PASSED if audit.statement is not None and audit.statement.word == "fail" else DONE


def _audit(options: argparse.Namespace) -> int:
    """Take labelled recordings of units, one file a unit and called by its serial. A file that
    cannot be used is named and left out, and the others are taken.
    """
    from softcal.app.calibration.redecision import confirm

    if options.confirm is not None:
        if options.files:
            raise InputError("--confirm takes no files: bring them first, then confirm what is in doubt")
        lot_id = lot_id_of(options.lot)
        with registry_of(options) as registry:
            act = partial(confirm, registry, lot_id, options.confirm, reason=options.reason)
            if not may_do(registry, lot_id, act, options.yes):
                return NOT_CONFIRMED
            act()
            withdraw_files(registry, lot_id)
            status = registry.pages.unit_statuses(lot_id, [options.confirm])[options.confirm]
        echo(f"{options.confirm}: confirmed; its verdict is {status.verdict}: {status.reasons[0]}")
        content = {"lot": lot_id, "serial": options.confirm, "verdict": status.verdict}
        answer(options, "lot.audit-confirm/1", content)
        return DONE if status.verdict == "pass" else SOME_UNIT_NOT_PASSED
    if not options.files:
        raise InputError("no file is given: name the labelled recordings, each called by the serial of its unit")
    return _store_files(options)


def _store_files(options: argparse.Namespace) -> int:
    from softcal.app.calibration.audit_files import read_audit_files, store_audits, unused_of_audits, write_audits
    from softcal.app.calibration.changes import carry_out
    from softcal.app.calibration.redecision import redecide
    from softcal.app.files.import_plan import Columns
    from softcal.app.files.importing import list_tables
    from softcal.app.files.lot_folder import open_lot_folder
    from softcal.app.files.measured_at import local_time_remarks, parse_instant
    from softcal.app.files.unused_parts import unread_files
    from softcal.app.registry.lot_recordings import source_of_lot, target_serials

    columns, table = (
        Columns(options.output_column, options.reference_column, options.time_column),
        table_options(options),
    )
    files = [file for path in options.files for file in list_tables(path)]
    measured_at = None if options.measured_at is None else parse_instant("--measured-at", options.measured_at)
    folder, replaced, next_step = Path(options.lot), list[str](), "they are scored, and the lot is judged"
    changes = None
    if (folder / "lot.toml").is_file():
        lot_folder = open_lot_folder(folder)
        lot = lot_folder.lot
        _check_rate(options.sample_rate, lot.sample_rate_Hz)
        audits = read_audit_files(lot, lot_folder.unit_paths.keys(), files, columns, table, measured_at)
        refusals, remarks = unused_of_audits(
            lot, audits, others=lot_folder.readable_audits(), source=lot_folder.read_source()
        )
        replaced, next_step = write_audits(folder, audits), f"next: softcal batch {options.lot}"
    else:
        with registry_of(options) as registry:
            lot = registry.lots.get(options.lot)
            _check_rate(options.sample_rate, lot.sample_rate_Hz)
            audits = read_audit_files(lot, target_serials(registry, lot.id), files, columns, table, measured_at)
            refusals, remarks = unused_of_audits(lot, audits, registry, source=source_of_lot(registry, lot))

            def store_and_redecide() -> None:
                store_audits(registry, lot.id, audits)
                redecide(registry, [lot.id])

            changes = carry_out(registry, lot.id, store_and_redecide)
            withdraw_files(registry, lot.id)
    for audit in audits:
        if audit.read is not None:
            echo_layout(audit.file, audit.read.table.layout, audit.read.remarks)
    for remark in local_time_remarks({one.read.table.path: one.read.start for one in audits if one.read is not None}):
        echo(remark)
    accepted = [audit.serial for audit in audits if audit.recording is not None]
    refused = {audit.file: str(audit.refusal) for audit in audits if audit.recording is None}
    layouts = {audit.file: audit.read.table.layout for audit in audits if audit.read is not None}
    not_used = (*(item for path in options.files for item in unread_files(path)), *refusals)
    content: dict[str, object] = {"lot": lot.id, "audited": accepted, "replaced": replaced, "refused": refused}
    content["layouts"] = layouts
    content["changes"] = changes and changes.to_json()
    if answer(options, "lot.audit-files/1", content | unused_json(not_used, remarks)):
        rows = [
            [audit.file, audit.serial, "taken" if audit.recording else f"refused: {audit.refusal}"] for audit in audits
        ]
        print_table(("file", "serial", "result"), rows)
        if changes is not None and (changes.changed or changes.recalled):
            print_changes(changes)
    if replaced:
        echo(f"an older audit of {', '.join(replaced)} was replaced")
    echo(f"{len(accepted)} of {len(audits)} files taken; {next_step}")
    echo_unused_input(not_used, remarks)
    return DONE if len(accepted) == len(audits) else InputError.exit_code


def _check_rate(declared_Hz: float | None, lot_Hz: float) -> None:
    """Refuse a table with another rate than the lot's: its windows would be of another length."""
    if declared_Hz is not None and abs(declared_Hz - lot_Hz) > 1e-3 * lot_Hz:
        raise InputError(f"--sample-rate is {declared_Hz:g} Hz, the lot's is {lot_Hz:g} Hz; nothing was taken")
