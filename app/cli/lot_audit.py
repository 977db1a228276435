"""`softcal lot audit`: bring labelled recordings into a lot, or confirm one that is in doubt."""

import argparse
from pathlib import Path

from softcal.app.cli.options import FILE, Action, add_shared, answer, lot_id_of, positive, registry_of
from softcal.app.output import print_table, say
from softcal.core.errors import InputError

DONE, SOME_UNIT_NOT_PASSED, REFUSED = 0, 1, 2
EXAMPLES = """examples:
  softcal lot audit lot-1 measured/*.csv         files called by their serials, columns t_s, output, reference
  softcal lot audit lot-1 EG-07.xlsx --time-column time --output-column V --reference-column N
  softcal lot audit lot-1 EG-07.csv --sample-rate 50        a table without a column of time
  softcal lot audit lot-1 --confirm EG-07 --reason "pressed again by hand, the same result"

LOT is a lot folder: the recordings go into its audit/, and `softcal batch LOT` judges by them. Or it is a lot of the
registry: they are kept there, and scored at once.
"""


def add_audit(action: Action) -> None:
    """Add `softcal lot audit`."""
    parser = action(
        "audit", "bring labelled recordings of units into the lot; confirm one that is in doubt", _run, epilog=EXAMPLES
    )
    add = parser.add_argument
    add("lot", metavar="LOT", help="lot folder, or a lot in the registry")
    add("files", nargs="*", **FILE, help="CSV, .xlsx or Parquet; of a folder, all")
    add("--output-column", default="output", help="default output; with * one unit per column")
    add("--reference-column", default="reference", help="column of the load cell; default reference")
    add("--time-column", metavar="NAME", help="column of the time in s; default t_s")
    add("--sample-rate", type=positive, metavar="HZ", help="without a column of time: samples a second")
    add("--sheet", help="sheet of an Excel file")
    add("--confirm", metavar="SERIAL", help="the audit of this unit is right in spite of the doubt")
    add("--reason", default="", help="why; needed with --confirm")
    add_shared(parser, "registry", "json")


def _run(options: argparse.Namespace) -> int:
    """Take labelled recordings of units, one file a unit and called by its serial. A file that
    cannot be used is named and left out, and the others are taken.
    """
    from softcal.app.batch.judging import confirm

    if options.confirm is not None:
        if options.files:
            raise InputError("--confirm takes no files: bring them first, then confirm what is in doubt")
        lot_id = lot_id_of(options.lot)
        with registry_of(options) as registry:
            confirm(registry, lot_id, options.confirm, reason=options.reason)
            standing = registry.pages.standings(lot_id, [options.confirm])[options.confirm]
        say(f"{options.confirm}: confirmed; its verdict is {standing.verdict}: {standing.reasons[0]}")
        facts = {"lot": lot_id, "serial": options.confirm, "verdict": standing.verdict}
        answer(options, "lot.audit-confirm/1", facts)
        return DONE if standing.verdict == "pass" else SOME_UNIT_NOT_PASSED
    if not options.files:
        raise InputError("no file is given: name the labelled recordings, each called by the serial of its unit")
    return _bring(options)


def _bring(options: argparse.Namespace) -> int:
    from softcal.app.batch.audit_files import look_at_audits, store_audits, write_audits
    from softcal.app.batch.judging import judge_again
    from softcal.app.files.importing import Columns, tables_of
    from softcal.app.files.lot_folder import open_lot_folder
    from softcal.app.registry.lot_recordings import target_serials

    time = options.time_column or (None if options.sample_rate else "t_s")
    columns = Columns(options.output_column, options.reference_column, time)
    files = [file for path in options.files for file in tables_of(path)]
    folder, replaced, then = Path(options.lot), list[str](), "they are scored, and the lot is judged"
    if (folder / "lot.toml").is_file():
        opened = open_lot_folder(folder)
        lot = opened.lot
        _check_rate(options.sample_rate, lot.sample_rate_Hz)
        looked = look_at_audits(lot, opened.unit_paths.keys(), files, columns, options.sheet)
        replaced, then = write_audits(folder, looked), f"next: softcal batch {options.lot}"
    else:
        with registry_of(options) as registry:
            lot = registry.lots.get(options.lot)
            _check_rate(options.sample_rate, lot.sample_rate_Hz)
            looked = look_at_audits(lot, target_serials(registry, lot.id), files, columns, options.sheet)
            store_audits(registry, lot.id, looked)
            judge_again(registry, [lot.id])
    taken = [audit.serial for audit in looked if audit.recording is not None]
    refused = {audit.file: str(audit.refusal) for audit in looked if audit.recording is None}
    facts = {"lot": lot.id, "audited": taken, "replaced": replaced, "refused": refused}
    if answer(options, "lot.audit-files/1", facts):
        rows = [
            [audit.file, audit.serial, "taken" if audit.recording else f"refused: {audit.refusal}"] for audit in looked
        ]
        print_table(("file", "serial", "result"), rows)
    if replaced:
        say(f"an older audit of {', '.join(replaced)} was replaced")
    say(f"{len(taken)} of {len(looked)} files taken; {then}")
    return DONE if len(taken) == len(looked) else REFUSED


def _check_rate(stated_Hz: float | None, lot_Hz: float) -> None:
    """Refuse a table with another rate than the lot's: its windows would be of another length."""
    if stated_Hz is not None and abs(stated_Hz - lot_Hz) > 1e-3 * lot_Hz:
        raise InputError(f"--sample-rate is {stated_Hz:g} Hz, the lot's is {lot_Hz:g} Hz; nothing was taken")
