"""`softcal gap`: diagnose the gap between twin and rig, and put the causes into the twin."""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from softcal.app.cli.gap_challenge import add_challenge_actions
from softcal.app.cli.gap_lot import add_lot, add_transfer
from softcal.app.cli.options import COUNT, FILE, actions_of, add_layout, add_shared, answer, table_options
from softcal.app.output import echo, print_table, write_json
from softcal.core.errors import InputError

if TYPE_CHECKING:
    from softcal.core.gap.case import DataMistake
    from softcal.core.gap.diagnosis import Diagnosis
    from softcal.core.gap.residual import ExplainedFraction
    from softcal.core.twin.parameters import ReadoutMetadata
    from softcal.core.twin.simulate import Twin

EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json --page rig-7.html
  softcal gap apply --report rig-7.gap.json --out rig-7.twin.json
  softcal gap transfer --report rig-7.gap.json --lot lot-1
  softcal gap challenge --cases 40 --out sealed
"""
_CASE_HELP = "folder with runs/<n>/recording.csv and recording.json, or one such run"
_DIAGNOSE_EXAMPLES = """examples:
  softcal gap diagnose rig-7 --json rig-7.gap.json
  softcal gap diagnose rig-7/runs/2 --json - --page run-2.html
  softcal gap diagnose S1.csv --vref-V 5 --adc-bits 10 --rate-Hz 50 --page S1.html
  softcal gap diagnose swing --simulator mass_spring_damper:SIMULATOR --json -     a simulator of your own

columns of recording.csv: t_s, stage_mm, force_N, output_V, temperature_C (what is missing narrows the diagnosis)
keys of recording.json:   vref_V, adc_bits, r_series_ohm, sample_rate_Hz, serial, profile, kind, sensor_type, dummy_ohm
kind: press (default), rest, rigid_block, dummy_resistor, dead_weights
"""
_CHECK_EXAMPLES = """examples:
  softcal gap check rig-7
  softcal gap check swing --simulator my_rig:SIMULATOR --json -
"""
_APPLY_EXAMPLES = """examples:
  softcal gap apply rig-7 --out rig-7.twin.json
  softcal gap apply --report rig-7.gap.json --out rig-7.twin.json    without diagnosing again
  softcal gap apply --report rig-7.gap.json --empirical --out rig-7.twin.json    with the terms that describe the rest
  softcal gap apply --report swing.gap.json --out swing.json    parameters of a simulator of your own
  softcal station unit --simulated --twin rig-7.twin.json --serial A1 --out A1.csv
  softcal demo --twin rig-7.twin.json
"""
_EFFECTS_EXAMPLES = """examples:
  softcal gap effects
  softcal gap effects --json effects.json
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Diagnose the gap between the twin and recordings of a rig.

    The report gives the stage, the effect, the shrink of the gap, and the next run.
    """
    action = actions_of(parser, "commands", "COMMAND")
    diagnose = action("diagnose", "find the causes of the gap in a case", _diagnose, epilog=_DIAGNOSE_EXAMPLES)
    _add_case(diagnose)
    add_shared(diagnose, "json")
    diagnose.add_argument(
        "--calibration",
        action="store_true",
        help="train f on the base twin, on the repaired twin and on the rig, and test it on the last run",
    )
    diagnose.add_argument("--page", **FILE, help="write a page of figures (standalone HTML)")
    check = action(
        "check", "say what the runs of a case can tell, before anything is diagnosed", _check, epilog=_CHECK_EXAMPLES
    )
    _add_case(check)
    add_shared(check, "json")
    apply = action("apply", "write the twin that explains a case", _apply, epilog=_APPLY_EXAMPLES)
    _add_case(apply, nargs="?")
    apply.add_argument("--report", **FILE, help="take the twin of this report instead of CASE")
    apply.add_argument("--out", required=True, **FILE, help="twin or parameters as JSON")
    apply.add_argument(
        "--empirical",
        action="store_true",
        help="add the empirical terms that describe what no cause explains, and the causes they stand beside",
    )
    add_shared(apply, "json")
    add_lot(action)
    effects = action("effects", "list the effects a diagnosis can name", _effects, epilog=_EFFECTS_EXAMPLES)
    add_shared(effects, "json", "csv")
    add_transfer(action)
    add_challenge_actions(action)


def _add_case(parser: argparse.ArgumentParser, nargs: str | None = None) -> None:
    parser.add_argument("case", type=Path, nargs=nargs, metavar="CASE", help=f"{_CASE_HELP}; or a plain table")
    table = parser.add_argument_group("electronics of a plain table (a case states its own)")
    add = table.add_argument
    add("--vref-V", type=float, dest="vref_V", metavar="V", help="supply of divider and ADC")
    add("--adc-bits", **COUNT, help="resolution of the ADC")
    add("--rate-Hz", type=float, dest="rate_Hz", metavar="HZ", help="sample rate")
    add("--series-ohm", type=float, metavar="OHM", help="series resistor; without it resistances come as shares of it")
    add_layout(parser)
    parser.add_argument(
        "--simulator",
        metavar="MODULE:NAME",
        help="a simulator of your own instead of the twin; columns are its inputs and channels",
    )
    parser.add_argument(
        "--processes", default=1, **COUNT, help="processes that call the simulator at the same time (default 1)"
    )


def _diagnose(options: argparse.Namespace) -> None:
    """Fit the base twin and every effect of the catalogue together to all runs of a case.

    Report the stage of the gap, its causes with probabilities, the shrink on held-out runs, and the next experiment.
    """
    if options.page:  # What a page needs is asked for before the search, not after it.
        from softcal.app.gap.page import write_page
    diagnosis = _diagnose_case(options)
    _show(diagnosis, options)
    if options.page:
        write_page(options.page, diagnosis)
    if options.simulator and (calls := diagnosis.model.calls(diagnosis.case)).count:
        echo(f"{calls.first}; so at {calls.count} of {calls.of} places, which were avoided")


def _check(options: argparse.Namespace) -> None:
    """Check the recordings for mistakes and fit the base.

    Print which of its parameters and which causes these runs identify, which they do not, and which run would. No
    cause is diagnosed.
    """
    from softcal.app.gap.diagnose import open_case_or_table
    from softcal.app.gap.simulator import load_simulator, read_runs
    from softcal.core.gap.diagnosis import check_case
    from softcal.core.gap.experiments import reasons
    from softcal.core.gap.simulator_model import check_simulator
    from softcal.core.gap.twin import TWIN

    if options.simulator:
        _refuse_electronics(options)
        simulator = load_simulator(options.simulator)
        result = check_simulator(simulator, read_runs(options.case, simulator, table_options(options))[0])
    else:
        case = open_case_or_table(options.case, _table_readout(options), table_options(options))
        result = check_case(case, TWIN)
    mistakes, identifiability = result
    record = None if identifiability is None else identifiability.record()
    data = [mistake.record() for mistake in mistakes]
    if not answer(options, "gap.check/1", {"data": data, "identifiability": record}):
        return
    _show_mistakes(mistakes)
    if identifiability is None:
        print("check       repair the recordings and check again; nothing else was judged")
        return
    for kind, is_base in (("base parameters", True), ("causes", False)):
        identifiable = [each.is_identifiable for each in identifiability.every if each.is_base == is_base]
        print(f"told        {sum(identifiable)} of {len(identifiable)} {kind}")
    for line in reasons(identifiability):
        print(f"not told    {line}")


def _show_mistakes(mistakes: "tuple[DataMistake, ...]") -> None:
    for mistake in mistakes:
        runs = ", ".join(map(str, mistake.runs)) or "all"
        kind = mistake.what.replace("_", " ") + (f" of {mistake.channel}" if mistake.channel else "")
        print(f"data        {kind}, runs {runs}: {mistake.evidence}")
        print(f"repair      {mistake.repair}")


def _refuse_electronics(options: argparse.Namespace) -> None:
    electronics = (options.vref_V, options.adc_bits, options.rate_Hz, options.series_ohm)
    if any(value is not None for value in electronics):
        raise InputError("--simulator knows no electronics; leave those options out")


def _table_readout(options: argparse.Namespace) -> "ReadoutMetadata | None":
    """Return the electronics of a plain table; R/Rs alone enters the divider: Rs may be unknown."""
    from softcal.core.twin.parameters import ReadoutMetadata

    electronics = (options.vref_V, options.adc_bits, options.rate_Hz)
    if all(value is None for value in (*electronics, options.series_ohm)):
        return None
    if options.case.is_dir():
        raise InputError(f"{options.case}: a case states its electronics in recording.json; leave the options out")
    if any(value is None for value in electronics):
        raise InputError("a plain table needs --vref-V, --adc-bits and --rate-Hz together")
    if options.series_ohm is None:
        echo("series resistor not given: resistances are shares of it")
    return ReadoutMetadata(options.vref_V, options.adc_bits, options.series_ohm or 1.0, options.rate_Hz)


def _effects(options: argparse.Namespace) -> None:
    """List the catalogue of effects: stage, equation, required channels.

    Also list effects of similar signature, and the runs that excite the effect. Effects of installed plug-ins are
    last.
    """
    from softcal.core.twin.catalogue import BUILTIN_EFFECTS, EFFECTS

    names = ("name", "unit", "low", "high", "usual")
    records, rows = [], []
    for effect in EFFECTS.values():
        needs, hides, shown_by = effect.signs.needs, effect.signs.confounders, effect.signs.best_experiments
        records.append(
            {
                "effect": effect.id,
                "stage": effect.stage,
                "equation": effect.equation,
                "source": effect.source,
                "parameters": [{name: getattr(p, name) for name in names} for p in effect.parameters],
                "needs": list(needs),
                "hides_behind": list(hides),
                "shown_by": list(shown_by),
                "forms": [form.effect.equation for form in effect.forms],
                "is_plugin": effect.id not in BUILTIN_EFFECTS,
            }
        )
        signs = [", ".join(each) or None for each in (needs, hides, shown_by)]
        rows.append([effect.id, effect.stage, effect.equation, *signs])
    if answer(options, "gap.effects/1", {"effects": records}):
        print_table(["effect", "stage", "equation", "needs", "hides behind", "shown by"], rows)


def _apply(options: argparse.Namespace) -> None:
    """Diagnose a case and write base parameters, noise and named causes as a twin that the
    simulated station and simulated lots can load.
    """
    from softcal.app.files.case_folder import read_json
    from softcal.app.gap.diagnose import apply_report, case_provenance, report_provenance
    from softcal.app.gap.simulator import load_simulator, read_parameters, write_parameters

    if (options.case is None) == (options.report is None):
        raise InputError("give either a case to diagnose or --report with the JSON of a diagnosis")
    diagnosis, source = None, str(options.report or options.case)
    if options.report is not None:
        report: Mapping[str, Any] = read_json(options.report)
    else:
        diagnosis = _diagnose_case(options)
        report = diagnosis.report()
    if report.get("simulator"):
        parameters = write_parameters(options.out, report, source, options.empirical)
        listed = ", ".join(f"{name} {'off' if v is None else f'= {v:.4g}'}" for name, v in parameters.items())
        echo(f"parameters of {report['simulator']} written to {options.out}: {listed}")
    else:
        provenance = report_provenance(options.report) if options.report else case_provenance(options.case)
        twin = apply_report(options.out, report, source, provenance, options.empirical)
        echo(f"twin written to {options.out}: {_contents(twin)}")
    if options.simulator:
        read_parameters(options.out, load_simulator(options.simulator))
    if diagnosis is not None and options.json != "-":
        _print(diagnosis, options)
    write_json(options.json, report)


def _diagnose_case(options: argparse.Namespace) -> "Diagnosis[Any]":
    """Return the diagnosis of a case, by the twin or by the user's simulator."""
    from softcal.app.gap.diagnose import case_provenance, diagnose_case
    from softcal.app.gap.simulator import foretell_duration, in_processes, load_simulator, read_runs
    from softcal.core.gap.simulator_model import diagnose_simulator

    if not options.simulator:
        with_calibration = getattr(options, "calibration", False)
        return diagnose_case(options.case, echo, _table_readout(options), table_options(options), with_calibration)
    if getattr(options, "calibration", False):
        raise InputError("--simulator has no force and output that f could be trained on; leave --calibration out")
    _refuse_electronics(options)
    declared = load_simulator(options.simulator)
    runs, serial = read_runs(options.case, declared, table_options(options))
    if duration := foretell_duration(declared, runs, options.processes):
        echo(duration)
    with in_processes(options.simulator, declared, options.processes) as simulator:
        diagnosis = diagnose_simulator(simulator, runs, serial, echo)
    return replace(diagnosis, provenance=case_provenance(options.case, options.simulator).to_json())


def _contents(twin: "Twin") -> str:
    names = [s.effect_id + (f" ({s.form})" if s.form else "") for s in twin.effects]
    names += [f"empirical {term.formula}" for term in twin.empirical]
    return ", ".join(names) or "no effect, the refitted base alone"


def _print(diagnosis: "Diagnosis[Any]", options: argparse.Namespace) -> None:
    from softcal.core.gap.experiments import reasons

    _show_mistakes(diagnosis.mistakes)
    if diagnosis.verdict == "data":
        print("verdict     data: repair the recordings and diagnose again; nothing else was judged")
        return
    explained_fraction = diagnosis.explained_fraction
    print(f"verdict     {diagnosis.verdict}")
    print(f"complete    {diagnosis.list_complete:.2f}: probability that nothing unmodelled is left")
    for channel, gap in diagnosis.gap.items():
        print(f"{channel:<11} {gap.rmse_before:.4g} before, {gap.rmse_after:.4g} after, floor {gap.noise_floor:.4g}")
    print(f"shrink      {explained_fraction.held_out:.2f} held out{_forecast(explained_fraction)}")
    for part, causes in enumerate(diagnosis.chosen, start=1):
        if causes != diagnosis.best.hypothesis.ids:
            print(f"            without part {part} of the runs: {' + '.join(causes) or 'no cause'}; scored so there")
    probable_causes = [c for c in diagnosis.causes if c.probability > 0.01]
    if probable_causes:
        hidden = diagnosis.hidden_fraction
        rows = []
        for c in probable_causes:
            values = ", ".join(f"{name} = {p.value:.3g} {p.unit}".rstrip() for name, p in c.parameters.items())
            rows.append([c.effect, c.stage, c.probability, c.shrink, c.alone, c.added, hidden.get(c.effect), values])
        head = ["effect", "stage", "probability", "shrink", "alone", "added", "hidden", "parameters"]
        print_table(head, rows)
    for fault in diagnosis.locations:
        print(f"where       {fault.stage}, {fault.channel}, {fault.regime}: {fault.share:.0%}  {fault.detail}")
    for name, value in diagnosis.on_bound.items():
        print(f"on bound    {name} = {value:.4g}: these recordings do not determine it, or they hold a mistake")
    for pair in diagnosis.ambiguous_with:
        print(f"ambiguous   {' / '.join(pair)}")
    print(f"next        {diagnosis.next_experiment.profile}: {diagnosis.next_experiment.why}")
    for line in () if diagnosis.identifiability is None else reasons(diagnosis.identifiability):
        print(f"not told    {line}")
    if diagnosis.partial is not None:
        effects = " + ".join(diagnosis.partial.effects)
        print(f"partly      {effects}: {diagnosis.partial.share:.0%} of the gap on these runs; the rest has no name")
    for cause in (c for c in diagnosis.causes if c.form and c.probability >= 0.5):
        print(f"form        {cause.effect}: the twin has it as {cause.form}; the values above are the catalogue's")
    if diagnosis.residual is not None:
        for fitted in diagnosis.residual.terms:
            error = f"standard error {fitted.standard_error:.1g} {fitted.term.unit}"
            print(f"empirical   {fitted.term.formula}  ({error})")
        rest, others = diagnosis.residual.explained_fraction, " + ".join(diagnosis.residual.other_causes)
        share = f"{rest.held_out:.2f} [{rest.low:.2f}, {rest.high:.2f}] held out"
        addition = f", beside {others}, which alone reach {diagnosis.residual.without:.2f}" if others else ""
        print(f"describes   {share}{addition}: a description, no cause; softcal gap apply --empirical adds it")
    if (rmse := diagnosis.calibration) is not None:
        twins = f"base twin {rmse.base:.3g} N, repaired twin {rmse.repaired:.3g} N"
        print(f"calibrates  error of f on run {rmse.run}, by what it was trained on: {twins}, rig {rmse.rig:.3g} N")
    for channel, noise in diagnosis.catalogue_fit.problem.correlation.items():
        print(f"noise       {channel}: {noise.spread:.3g} beside the white noise, fading within {noise.fading_s:.2g} s")
    if options.simulator:
        for name, prior in diagnosis.model.summarise_priors(diagnosis.best).items():
            print(f"prior       {name} = {prior['mean']:.4g} ± {prior['sd']:.2g}, fitted {prior['fitted']:.4g}")
        return
    if diagnosis.case.missing_channels:
        print(f"missing     {', '.join(diagnosis.case.missing_channels)}")
    if diagnosis.case.unseen_stages:
        print(f"not judged  {', '.join(diagnosis.case.unseen_stages)}: these recordings cannot show them")


def _forecast(explained_fraction: "ExplainedFraction") -> str:
    if explained_fraction.predicted is None:
        return "; no forecast: the samples held out contradict it"
    return (
        f"; forecast {explained_fraction.predicted:.2f} [{explained_fraction.low:.2f}, {explained_fraction.high:.2f}]"
    )


def _show(diagnosis: "Diagnosis[Any]", options: argparse.Namespace) -> None:
    """Print the diagnosis as tables, then write its report; `--json -` prints the report alone."""
    if options.json != "-":
        _print(diagnosis, options)
    write_json(options.json, diagnosis.report())
