"""`softcal lot`: watch a lot folder, and set the limit its units are judged by."""

import argparse
from pathlib import Path

from softcal.app.bootstrap import open_chosen_registry
from softcal.app.commands.options import add_json, add_network, add_registry, network_config
from softcal.app.output import print_table, say, write_json
from softcal.core.errors import InputError

DONE, SOME_UNIT_NOT_PASSED = 0, 1
EXAMPLES = """examples:
  softcal lot watch lot-1                        calibrate units as their recordings land, until Ctrl-C
  softcal lot watch lot-1 --idle 60 --jobs 2     stop when nothing came for a minute
  softcal lot limit lot-1 --rmse 0.15 --reason "customer drawing, revision C"
  softcal lot limit lot-1                        every version of the limit, who set it and why
"""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `softcal lot`."""
    parser = commands.add_parser(
        "lot",
        help="watch a lot folder; set the limit of a lot",
        description="What concerns a lot as a whole.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    watch = actions.add_parser("watch", help="calibrate units as their recordings land")
    watch.add_argument("folder", type=Path, metavar="LOT", help="lot folder")
    add_registry(watch)
    watch.add_argument("--every", type=float, default=2.0, metavar="S", help="seconds between two looks (default 2)")
    watch.add_argument("--idle", type=float, metavar="S", help="stop when nothing came for so long (default: never)")
    watch.add_argument("--jobs", type=int, default=1, metavar="N", help="worker processes (default 1)")
    add_network(watch)
    watch.set_defaults(run=_watch)
    limit = actions.add_parser("limit", help="show or set the largest acceptable error of a lot's units")
    limit.add_argument("lot", metavar="ID", help="lot in the registry")
    add_registry(limit)
    add_json(limit)
    limit.add_argument("--rmse", type=float, help="new limit in the lot's reference unit")
    limit.add_argument("--reason", help="why; needed with --rmse")
    limit.add_argument("--expect", type=int, metavar="VERSION", help="refuse when somebody changed it since")
    limit.set_defaults(run=_limit)


def _watch(options: argparse.Namespace) -> int:
    from softcal.app.engine import EngineChoice
    from softcal.app.workflow.batch import TABLE_HEADER, BatchConfig, Watch, table_row
    from softcal.app.workflow.watch import WatchConfig, watch_lot

    if not options.every > 0 or (options.idle is not None and not options.idle > 0):
        raise InputError("--every and --idle are seconds above 0")
    batch = BatchConfig(network=network_config(options), engine=EngineChoice(jobs=options.jobs), actor="softcal lot")
    passed = True
    say(f"{options.folder}: waiting for recordings; Ctrl-C stops")
    with open_chosen_registry(options.registry) as registry:
        config = WatchConfig(options.every, options.idle)
        try:
            for report in watch_lot(options.folder, registry, batch, config, Watch()):
                print_table(TABLE_HEADER, [table_row(unit) for unit in report.units])
                passed = passed and report.counts["pass"] == len(report.units)
        except KeyboardInterrupt:
            say("stopped; what was finished is kept")
    return DONE if passed else SOME_UNIT_NOT_PASSED


def _limit(options: argparse.Namespace) -> int:
    if options.rmse is not None and not (options.reason or "").strip():
        raise InputError("--rmse needs --reason: a limit without a reason cannot be defended")
    with open_chosen_registry(options.registry, create=False) as registry:
        if options.rmse is not None:
            registry.set_limit(options.lot, options.rmse, reason=options.reason, expected_version=options.expect)
        unit = registry.lot(options.lot).reference_unit
        versions = registry.limit_versions(options.lot)
    if options.json:
        entries = [vars(entry) | {"made_at": entry.made_at.isoformat()} for entry in versions]
        write_json(options.json, {"schema": "softcal.lot.limit/1", "unit": unit, "versions": entries})
    if options.json != "-":
        rows = [[e.version, e.rmse, f"{e.made_at:%Y-%m-%d %H:%M}", e.actor, e.reason] for e in versions]
        print_table(("version", f"limit {unit}", "set (UTC)", "by", "reason"), rows)
    return DONE
