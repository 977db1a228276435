"""`softcal gap`: diagnose the gap between the twin and a rig, apply what was found, and check both blindly."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from softcal.app.commands import gap_challenge
from softcal.app.commands.options import add_json
from softcal.app.output import print_table, say, write_json

if TYPE_CHECKING:
    from softcal.core.gap.diagnosis import Cause, Diagnosis

_EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json --page rig-7.html
  softcal gap apply rig-7 --out rig-7.twin.json
  softcal gap challenge --cases 40 --out sealed
"""
_CASE_HELP = "folder with runs/<n>/recording.csv and recording.json, or one such run"
_DIAGNOSE_EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json
  softcal gap diagnose rig-7/runs/2 --json - --page run-2.html

columns of recording.csv: t_s, stage_mm, force_N, output_V, temperature_C (what is missing narrows the diagnosis)
keys of recording.json:   vref_V, adc_bits, r_series_ohm, sample_rate_Hz, serial, profile, kind, sensor_type, dummy_ohm
kind: press (default), rest, rigid_block, dummy_resistor, dead_weights
"""
_APPLY_EXAMPLES = """examples:
  softcal gap apply rig-7 --out rig-7.twin.json
"""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add `softcal gap` and its commands."""
    parser = commands.add_parser(
        "gap",
        help="diagnose the sim-to-real gap: where, which cause, how far it shrinks",
        description="Compare the twin with recordings of a rig: where it is wrong, which effect causes it, how far the "
        "gap shrinks when that effect is added, and what to press next.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    inner = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_diagnose(inner)
    _add_apply(inner)
    gap_challenge.add_parsers(inner)


def _add_diagnose(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = commands.add_parser(
        "diagnose",
        help="find the causes of the gap in a case",
        description="Fit the base twin and every effect of the catalogue jointly to all runs of a case and report "
        "where the gap lies, its causes with probabilities, the shrink on held-out runs, and the next experiment.",
        epilog=_DIAGNOSE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("case", type=Path, metavar="CASE", help=_CASE_HELP)
    add_json(parser)
    parser.add_argument("--page", type=Path, metavar="FILE", help="write a page of figures (standalone HTML)")
    parser.set_defaults(run=_diagnose)


def _add_apply(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = commands.add_parser(
        "apply",
        help="write the twin that explains a case",
        description="Diagnose a case and write base parameters, noise and named causes as a twin that the simulated "
        "station and simulated lots can load.",
        epilog=_APPLY_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("case", type=Path, metavar="CASE", help=_CASE_HELP)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="twin as JSON")
    add_json(parser)
    parser.set_defaults(run=_apply)


def _diagnose(options: argparse.Namespace) -> int:
    from softcal.app.workflow.diagnose import diagnose_case, write_page

    diagnosis = diagnose_case(options.case, say)
    if options.page:
        write_page(options.page, diagnosis)
    _show(diagnosis, options.json)
    return 0


def _apply(options: argparse.Namespace) -> int:
    from softcal.app.workflow.diagnose import apply_case

    diagnosis = apply_case(options.case, options.out, say)
    say(f"twin written to {options.out}")
    _show(diagnosis, options.json)
    return 0


def _show(diagnosis: "Diagnosis", target: str | None) -> None:
    """Print the diagnosis as tables; with `--json -` the record alone goes to standard output."""
    if target:
        write_json(target, diagnosis.report())
    if target == "-":
        return
    shrink = diagnosis.shrink
    print(f"verdict     {diagnosis.verdict}")
    for channel, gap in diagnosis.gap.items():
        print(f"{channel:<11} {gap.rmse_before:.4g} before, {gap.rmse_after:.4g} after, floor {gap.noise_floor:.4g}")
    forecast = f"{shrink.predicted:.2f} [{shrink.low:.2f}, {shrink.high:.2f}]"
    print(f"shrink      {shrink.held_out:.2f} held out; forecast {forecast}")
    named = [c for c in diagnosis.causes if c.probability > 0.01]
    if named:
        print_table(
            ["effect", "stage", "probability", "shrink", "hidden", "parameters"],
            [
                [c.effect, c.stage, c.probability, c.shrink, diagnosis.hidden_fraction.get(c.effect), _values(c)]
                for c in named
            ],
        )
    for place in diagnosis.places:
        print(f"where       {place.stage}, {place.channel}, {place.regime}: {place.share:.0%}  {place.detail}")
    for pair in diagnosis.ambiguous_with:
        print(f"ambiguous   {' / '.join(pair)}")
    print(f"next        {diagnosis.next_experiment.profile}: {diagnosis.next_experiment.why}")
    if diagnosis.case.missing_channels:
        print(f"missing     {', '.join(diagnosis.case.missing_channels)}")


def _values(cause: "Cause") -> str:
    return ", ".join(f"{name} = {p.value:.3g} {p.unit}".rstrip() for name, p in cause.parameters.items())
