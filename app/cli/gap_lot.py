"""`softcal gap lot` and `transfer`: a rig's lot diagnosed as one, and foretold by its twins."""

import argparse
from pathlib import Path

from softcal.app.cli.options import DIR, FILE, Action, add_shared
from softcal.app.output import echo, print_table, write_json

_LOT_EXAMPLES = """examples:
  softcal gap lot lot-7
  softcal gap lot lot-7 --json lot-7.gap.json

lot-7/A1/runs/1/recording.csv and recording.json    a case per unit, as softcal gap diagnose takes it
lot-7/A1/audit/recording.csv and recording.json     a run kept back: f of twins and of the rig is tested on it
"""
_TRANSFER_EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json
  softcal gap transfer --report rig-7.gap.json --lot lot-1
  softcal gap transfer --report rig-7.gap.json --lot lot-1 --json transfer.json

The lot's recordings must hold stage_mm: simulated units are pressed along the same positions.
"""
_LABELS = {
    "before": "error without a map, N",
    "after": "error with the map, N",
    "own": "error of an own calibration, N",
    "after_by_own": "with the map / own calibration",
}


def add_lot(action: Action) -> None:
    """Add `softcal gap lot`."""
    parser = action("lot", "diagnose many units of one lot together", _lot, epilog=_LOT_EXAMPLES)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="one case folder per unit")
    add_shared(parser, "json")


def _lot(options: argparse.Namespace) -> None:
    """Diagnose one case per unit and add up their evidence. Say which causes the units share, at
    which size in each, and which units do not follow. Units with an audit show how many rig
    recordings the twin saves.
    """
    from softcal.app.gap.diagnose import case_provenance
    from softcal.app.gap.lot import diagnose_lot_folder

    lot = diagnose_lot_folder(options.folder, echo)
    write_json(options.json, lot.record() | {"provenance": case_provenance(options.folder).to_json()})
    if options.json == "-":
        return
    diagnosis, calibration = lot.diagnosis, lot.calibration
    print(f"verdict     {diagnosis.verdict}")
    word = "nearest" if diagnosis.verdict == "unknown" else "shared"
    for cause in diagnosis.causes:
        print(f"{word:<11} {cause}: probability {diagnosis.probability[cause]:.3g} over the lot")
    competing = diagnosis.competing_hypotheses
    for ids in competing[1:]:
        print(f"ambiguous   {' + '.join(competing[0]) or 'no cause'} / {' + '.join(ids) or 'no cause'}")
    rows = []
    for member in diagnosis.members:
        causes = " + ".join(member.diagnosis.best.hypothesis.ids) or "no cause"
        if member.is_excluded:
            print(f"left out    {member.name}: {'; '.join(str(m.evidence) for m in member.diagnosis.mistakes)}")
        elif not member.follows:
            alone = f"alone {member.diagnosis.verdict}, {causes}"
            print(f"outlier     {member.name}: does not share the lot's causes; {alone}")
        rows += [
            [member.name, member.diagnosis.verdict, effect, name, p.value, p.low, p.high, p.unit]
            for effect, values in member.sizes.items()
            for name, p in values.items()
        ]
    if rows:
        print_table(["unit", "alone", "effect", "parameter", "value", "low", "high", "unit of value"], rows)
    if calibration:
        max_rigs = max(len(w.rig) for w in calibration)
        rigs = (f"rig {k}, N" for k in range(1, max_rigs + 1))
        header = ["unit", "nominal twin, N", "explained twin, N", *rigs, "saves"]
        print_table(header, [[w.unit, w.nominal, w.explained, *w.rig, w.saves] for w in calibration])
        print(
            f"saves       {sum(w.saves for w in calibration)} rig recordings over {len(calibration)} units; "
            f"the twin without the causes saves {sum(w.nominal_saves for w in calibration)}"
        )


def add_transfer(action: Action) -> None:
    """Add `softcal gap transfer`."""
    parser = action(
        "transfer",
        "compare calibration results in simulation with those on the rig",
        _transfer,
        epilog=_TRANSFER_EXAMPLES,
    )
    parser.add_argument("--report", required=True, **FILE, help="JSON of softcal gap diagnose")
    parser.add_argument("--lot", required=True, **DIR, help="lot folder with audits, from the rig")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated units' spread and noise (default 0)")
    add_shared(parser, "json")


def _transfer(options: argparse.Namespace) -> None:
    """Calibrate three lots in the same way: pressed on the rig, simulated with the refitted base
    twin, and with the explained twin. Show which twin foretells the rig's results.
    """
    from softcal.app.gap.lot import check_transfer

    transfer = check_transfer(options.report, options.lot, options.seed, echo)
    write_json(options.json, transfer.to_record())
    if options.json != "-":
        header = ("median over units", "rig", "base twin", "explained twin", "base off by", "explained off by")
        print_table(header, [(_LABELS[n], *v, f"{b:.0%}", f"{e:.0%}") for n, *v, b, e in transfer.rows()])
