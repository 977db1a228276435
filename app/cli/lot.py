"""`softcal lot`: watch a lot folder, set its limit, plan its audits and release it."""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

from softcal.app.cli.confirm import NOT_CONFIRMED, is_confirmed, print_changes, withdraw_files
from softcal.app.cli.lot_audit import add_audits
from softcal.app.cli.lot_fit import add_fit
from softcal.app.cli.options import (
    COUNT,
    DIR,
    FILE,
    actions_of,
    add_network,
    add_shared,
    answer,
    lot_id_of,
    network_config,
    registry_of,
)
from softcal.app.output import echo, print_reasons, print_table
from softcal.app.texts.catalogue import format_local_instant
from softcal.core.errors import InputError, NotCalibrated, RegistryReadOnly
from softcal.core.quality.line_rules import LETTERS, RETESTS

DONE, SOME_UNIT_NOT_PASSED = 0, 1

EXAMPLES = """examples:
  softcal lot watch lot-1                        calibrate units as their recordings land, until Ctrl-C
  softcal lot watch lot-1 --idle 60 --jobs 2     stop when nothing came for a minute
  softcal lot limit lot-1 --rmse 0.15 --reason "customer drawing, revision C"    says what changes, and asks
  softcal lot limit lot-1                        every version of the limit, who set it and why
  softcal lot limit lot-1 --withdraw --reason "the drawing was withdrawn" --yes
  softcal lot fit lot-1                          map units pressed by one load at once together: says what changes, asks
  softcal lot fit lot-1 --withdraw --reason "the press was not the same" --yes
  softcal lot network lot-1                      networks of the lot, and which of them the line uses
  softcal lot network lot-1 --release 3f2a9c0b --reason "trained on the new source"
  softcal lot rules lot-1 --serial-pattern 'EG-[0-9]{4}' --letters upper --target 500 --reason "order 4711"
  softcal lot rules lot-1 --retests fail=0 retest=3 --reason "customer allows no second try"
  softcal lot audit-plan lot-1                   which few units to check with the load cell, and how far that is
  softcal lot audit lot-1 measured/*.csv         bring their labelled recordings, each called by its serial
  softcal lot release lot-1 --pdf lot-1.pdf      what is promised about the units nobody measured, on one page
  softcal lot audit-plan lot-1 --new --random 20 --reason "first draw was lost in transit"

After `lot audit` run `softcal batch` again: it measures the audited units and judges the lot.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Commands on a lot as a whole."""
    action = actions_of(parser)
    watch = action("watch", "calibrate units as their recordings land", _watch)
    watch.add_argument("folder", type=Path, metavar="LOT", help="lot folder")
    add_shared(watch, "registry")
    watch.add_argument("--every", type=float, default=2.0, metavar="S", help="seconds between two looks (default 2)")
    watch.add_argument("--idle", type=float, metavar="S", help="stop when nothing came for so long (default: never)")
    watch.add_argument("--jobs", default=1, **COUNT, help="worker processes (default 1)")
    add_network(watch)
    folder = action(
        "folder",
        "write a lot of the registry as a lot folder, for example one that a station recorded on orders",
        _folder,
    )
    folder.add_argument("lot", metavar="ID", help="lot in the registry")
    folder.add_argument("--out", required=True, **DIR, help="lot folder to make; not there yet")
    add_shared(folder, "registry", "json")
    add_fit(action)
    limit = action("limit", "show or set the largest acceptable error of a lot's units", _limit)
    limit.add_argument("lot", metavar="ID", help="lot in the registry")
    add_shared(limit, "registry", "json", "csv")
    new = limit.add_mutually_exclusive_group()
    new.add_argument("--rmse", type=float, help="new limit in the lot's reference unit")
    new.add_argument("--withdraw", action="store_true", help="take the limit back: then no unit passes")
    add_shared(limit, "yes")
    limit.add_argument("--reason", help="why; needed with a new limit")
    limit.add_argument("--expect", type=int, metavar="VERSION", help="refuse when somebody changed it since")
    network = action("network", "show or decide which network of a lot the line uses", _network)
    network.add_argument("lot", metavar="ID", help="lot in the registry")
    add_shared(network, "registry", "json", "csv")
    choice = network.add_mutually_exclusive_group()
    choice.add_argument("--release", metavar="NETWORK", help="use this one from now on; the first digits of its id do")
    choice.add_argument("--withdraw", metavar="NETWORK", help="take it from the line; the one before it is used again")
    network.add_argument("--reason", default="", help="why; needed with a decision")
    rules = action(
        "rules", "show or set how a lot's serials look, how many are planned, and who may be pressed again", _rules
    )
    add = rules.add_argument
    add("lot", metavar="ID", help="lot in the registry")
    add_shared(rules, "registry", "json")
    add("--serial-pattern", metavar="REGEX", help="what a whole serial matches; '' takes any")
    add("--letters", choices=LETTERS, help="turn what was scanned into these letters")
    add("--target", **COUNT, help="units that are planned")
    add("--retests", nargs="+", metavar="VERDICT=N", help=f"re-tests after a verdict: {', '.join(RETESTS)}")
    add("--reason", default="", help="why; needed with every change")
    add_audits(action)
    release = action(
        "release", "what is promised about the lot's released units, at what risk, on what evidence", _release
    )
    release.add_argument("lot", metavar="ID", help="lot in the registry, or its folder")
    add_shared(release, "registry", "json", "csv")
    release.add_argument("--pdf", **FILE, help="write the statement as one page")
    release.add_argument("--language", choices=("en", "ko"), default="en", help="of the page")


def _release(options: argparse.Namespace) -> int:
    """Release unmeasured units by the audits in the registry, and print the consumer's risk."""
    from softcal.app.calibration.release import decide_lot, is_decided, read_lot_status
    from softcal.app.export.certificates.lot_statement import build_lot_statement, lot_statement_pdf
    from softcal.app.files.atomic import write_bytes
    from softcal.app.texts.catalogue import text
    from softcal.app.texts.reason_groups import reasons_by_verdict
    from softcal.core.quality.lot_status import Disposition
    from softcal.core.unit.verdict import VERDICTS

    lot_id = lot_id_of(options.lot)
    with registry_of(options) as registry:
        registry.lots.get(lot_id)
        status = read_lot_status(registry, lot_id)
        if status.decided is not None and not is_decided(registry, status):
            # What every change has judged already is only read, so that an account that may not write can ask.
            try:
                decide_lot(registry, lot_id)
            except RegistryReadOnly as error:
                raise RegistryReadOnly(
                    f"lot {lot_id}: its audits or its limit changed, and nobody has judged it since; have somebody do "
                    f"this who may write ({error})"
                ) from error
            withdraw_files(registry, lot_id)
            status = read_lot_status(registry, lot_id)
        release = status.decided
        if release is None:
            raise NotCalibrated(f"lot {lot_id!r} has no calibrated unit yet; run `softcal batch` first")
        statement = build_lot_statement(registry, status, release)
    if options.pdf is not None:
        write_bytes(options.pdf, lot_statement_pdf(statement, partial(text, options.language)))
        echo(f"{options.pdf}: statement on lot {lot_id}")
    content = {"lot": lot_id, "sample": statement.sample.to_json(), "provenance": statement.provenance.to_json()}
    if answer(options, "lot.release/1", content | status.to_json()):
        limit = release.limit.stated_rmse
        rows = [
            [
                *(a.serial, a.lot_id or lot_id, a.forecast_rmse, a.measured_rmse, a.ratio),
                None if limit is None else "within" if a.measured_rmse <= limit else "beyond",
            ]
            for a in sorted(release.audits, key=lambda audit: -audit.ratio)
        ]
        print_table(("audited", "lot", "forecast", "measured", "measured/forecast", "result"), rows)
        print(release.statement)
        print(f"sample: {statement.sample.render(partial(text, 'en'))}")
        print(f"released by sample: {', '.join(unit.serial for unit in status.on(Disposition.SAMPLED)) or 'none'}")
        for name, units in (("waiting", status.on(Disposition.WAITING)), ("withdrawn", status.withdrawn)):
            for subject, reasons in reasons_by_verdict(units, reversed(VERDICTS)):
                print_reasons(f"{name}: {subject}", reasons)
    return DONE if all(unit.verdict == "pass" for unit in status.units) else SOME_UNIT_NOT_PASSED


def _folder(options: argparse.Namespace) -> None:
    from softcal.app.registry.lot_files import write_lot_folder

    with registry_of(options) as registry:
        written = write_lot_folder(registry, options.lot, options.out)
    echo(f"{options.out}: " + ", ".join(f"{len(serials)} in {part}/" for part, serials in written.items()))
    answer(options, "lot.folder/1", {"lot": options.lot, **written})


def _watch(options: argparse.Namespace) -> int:
    from softcal.app.batch.engine import EngineChoice
    from softcal.app.batch.lot_work import BatchConfig, Callbacks
    from softcal.app.batch.report import TABLE_HEADER, table_row
    from softcal.app.batch.watch import watch_lot

    if not options.every > 0 or (options.idle is not None and not options.idle > 0):
        raise InputError("--every and --idle are seconds above 0")
    batch = BatchConfig(network=network_config(options), engine=EngineChoice(jobs=options.jobs), actor="softcal lot")
    passed = True
    echo(f"{options.folder}: waiting for recordings; Ctrl-C stops")
    with registry_of(options, create=True) as registry:
        try:
            for report in watch_lot(options.folder, registry, batch, Callbacks(), options.every, options.idle):
                print_table(TABLE_HEADER, [table_row(unit) for unit in report.units])
                passed = passed and report.has_passed
        except KeyboardInterrupt:
            echo("stopped; what was finished is kept")
    return DONE if passed else SOME_UNIT_NOT_PASSED


def _limit(options: argparse.Namespace) -> int:
    """Print what another limit would change, and ask; without a new one, every version of it."""
    from softcal.app.calibration.changes import change_limit, preview_limit

    is_new = options.rmse is not None or options.withdraw
    if is_new and not (options.reason or "").strip():
        raise InputError("a new limit needs --reason: without one it cannot be defended")
    changes, is_done = None, False
    with registry_of(options) as registry:
        unit = registry.lots.get(options.lot).reference_unit
        if is_new:
            changes = preview_limit(registry, options.lot, options.rmse)
            if options.json != "-":
                print_changes(changes)
            if is_done := is_confirmed(options.yes):
                change_limit(
                    registry, options.lot, options.rmse, reason=options.reason, expected_version=options.expect
                )
                withdraw_files(registry, options.lot)
        versions = registry.lots.limit_versions(options.lot)
    entries = [vars(entry) | {"made_at": entry.made_at.isoformat()} for entry in versions]
    content = {"unit": unit, "versions": entries, "changes": changes and changes.to_json(), "is_done": is_done}
    if answer(options, "lot.limit/1", content):
        rows = [[e.version, e.rmse, format_local_instant(e.made_at), e.actor, e.reason] for e in versions]
        print_table(("version", f"limit {unit}", "set", "by", "reason"), rows)
    return NOT_CONFIRMED if is_new and not is_done else DONE


def _network(options: argparse.Namespace) -> None:
    with registry_of(options) as registry:
        registry.lots.get(options.lot)
        if prefix := options.release or options.withdraw:
            ids = [one.network.id for one in registry.networks.states(options.lot)]
            fitting = [id_ for id_ in ids if id_.startswith(prefix)]
            if len(fitting) != 1:
                raise InputError(
                    f"{len(fitting)} networks of lot {options.lot!r} begin with {prefix!r}; one was expected"
                )
            decide = registry.networks.release if options.release else registry.networks.withdraw
            decide(fitting[0], reason=options.reason)
        states = registry.networks.states(options.lot)
    networks = [{"id": one.network.id, "state": one.state} for one in states]
    if answer(options, "lot.network/1", {"lot": options.lot, "networks": networks}):
        rows = [[one.network.id[:12], one.state, format_local_instant(one.network.added_at)] for one in states]
        print_table(("network", "state", "trained"), rows)


def _rules(options: argparse.Namespace) -> None:
    changes = {name: getattr(options, name) for name in ("serial_pattern", "letters", "target")}
    changes = {name: value for name, value in changes.items() if value is not None}
    with registry_of(options) as registry:
        rules = registry.lots.line_rules(registry.lots.get(options.lot))
        if options.retests:
            changes["retests"] = dict(rules.retests)
            for text in options.retests:
                verdict, _, times = text.partition("=")
                if not times.isdigit():
                    raise InputError(f"--retests {text!r}: VERDICT=N was expected, for example fail=1")
                changes["retests"][verdict] = int(times)
        if changes:
            registry.lots.set_line_rules(options.lot, replace(rules, **changes), reason=options.reason)
        versions = registry.lots.line_rules_versions(options.lot)
        rules = registry.lots.line_rules(registry.lots.get(options.lot))
    entries = [vars(e) | {"made_at": e.made_at.isoformat(), "rules": e.rules.settings()} for e in versions]
    if answer(options, "lot.rules/1", {"now": rules.settings(), "versions": entries}):
        retests = ", ".join(f"{times} after {verdict}" for verdict, times in rules.retests.items())
        values = rules.settings() | {"serial_pattern": rules.serial_pattern or "any", "retests": retests}
        print_table(
            ("rule", "holds now"), [[name, "–" if value is None else str(value)] for name, value in values.items()]
        )
        rows = [[e.version, format_local_instant(e.made_at), e.actor, e.reason] for e in versions]
        print_table(("version", "set", "by", "reason"), rows)
