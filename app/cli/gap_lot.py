"""`softcal gap lot`: many units of one lot diagnosed together."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.cli.options import add_json

if TYPE_CHECKING:
    from softcal.core.gap.shared_cause import LotDiagnosis
    from softcal.core.gap.worth import CalibrationWorth

_EXAMPLES = """examples:
  softcal gap lot lot-7
  softcal gap lot lot-7 --json lot-7.gap.json

lot-7/A1/runs/1/recording.csv and recording.json    a case per unit, as softcal gap diagnose takes it
lot-7/A1/audit/recording.csv and recording.json     a run kept back: f of twins and of the rig is tested on it
"""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `softcal gap lot`."""
    parser = commands.add_parser(
        "lot",
        help="diagnose many units of one lot together",
        description="Diagnose one case per unit and add up their evidence. Say which causes the units share, at which "
        "size in each, and which units do not follow. Units with an audit show how many rig recordings the twin saves.",
        epilog=_EXAMPLES,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="one case folder per unit")
    add_json(parser)
    parser.set_defaults(run=_lot)


def _lot(options: argparse.Namespace) -> int:
    from softcal.app.gap.lot import diagnose_lot_folder
    from softcal.app.output import say, write_json

    found = diagnose_lot_folder(options.folder, say)
    write_json(options.json, found.record())
    if options.json != "-":
        _show(found.diagnosis)
        _show_worth(found.calibration)
    return 0


def _show(found: "LotDiagnosis") -> None:
    from softcal.app.output import print_table

    print(f"verdict     {found.verdict}")
    word = "nearest" if found.verdict == "unknown" else "shared"
    for cause in found.causes:
        print(f"{word:<11} {cause}: probability {found.probability[cause]:.3g} over the lot")
    for ids in found.rivals[1:]:
        print(f"ambiguous   {' + '.join(found.rivals[0]) or 'no cause'} / {' + '.join(ids) or 'no cause'}")
    for member in found.members:
        own = " + ".join(member.diagnosis.best.hypothesis.ids) or "no cause"
        if member.is_left_out:
            print(f"left out    {member.name}: {'; '.join(str(m.evidence) for m in member.diagnosis.mistakes)}")
        elif not member.follows:
            print(
                f"outlier     {member.name}: does not share the lot's causes; alone {member.diagnosis.verdict}, {own}"
            )
    rows = [
        [m.name, m.diagnosis.verdict, effect, name, p.value, p.low, p.high, p.unit]
        for m in found.members
        for effect, values in m.sizes.items()
        for name, p in values.items()
    ]
    if rows:
        print_table(["unit", "alone", "effect", "parameter", "value", "low", "high", "unit of value"], rows)


def _show_worth(calibration: "tuple[CalibrationWorth, ...]") -> None:
    from softcal.app.output import print_table

    if not calibration:
        return
    most = max(len(w.rig) for w in calibration)
    header = ["unit", "nominal twin, N", "explained twin, N", *(f"rig {k}, N" for k in range(1, most + 1)), "saves"]
    print_table(header, [[w.unit, w.nominal, w.explained, *w.rig, w.saves] for w in calibration])
    print(
        f"saves       {sum(w.saves for w in calibration)} rig recordings over {len(calibration)} units; "
        f"the twin without the causes saves {sum(w.nominal_saves for w in calibration)}"
    )
