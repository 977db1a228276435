"""`softcal quality`: gauge studies, capability, yields and golden units."""

import argparse
from pathlib import Path

from softcal.app.cli.options import COUNT, actions_of, add_shared, answer, registry_of
from softcal.app.output import print_table
from softcal.core.errors import InputError

EXAMPLES = """examples:
  softcal quality grr study.csv              columns unit, station, trial, value; one row per press
  softcal quality yield --lot lot-1
  softcal quality capability --lot lot-1     predicted errors against the lot's limit
  softcal quality capability --file peaks.csv --column peak_N --min 2.8 --max 3.2
  softcal quality golden --station line-1 --baseline 20

A capability is refused while the process is not stable: the number would promise what nobody can keep.
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Numbers for quality: is the gauge good enough, is the process stable, how many units pass."""
    action = actions_of(parser, shared=("json", "csv"), is_described=True)
    grr = action("grr", "gauge repeatability and reproducibility", _grr)
    grr.add_argument("file", type=Path, metavar="CSV", help="columns unit, station, trial, value")
    grr.add_argument("--method", choices=("anova", "range"), default="anova", help="default: anova")
    grr.add_argument("--tolerance", type=float, metavar="WIDTH", help="also in %% of this tolerance width")
    able = action("capability", "Cp, Cpk, Pp, Ppk with interval, on a stable process only", _capability)
    add_shared(able, "registry")
    able.add_argument("--lot", metavar="ID", help="predicted errors of this lot")
    able.add_argument("--file", type=Path, metavar="CSV", help="numbers from a file instead, in time order")
    able.add_argument("--column", help="which column of the file")
    able.add_argument("--min", type=float, dest="minimum")
    able.add_argument("--max", type=float, dest="maximum", help="default: the lot's limit")
    count = action("yield", "first-pass, second-pass and final yield of a lot", _yield)
    add_shared(count, "registry")
    count.add_argument("--lot", metavar="ID", required=True)
    count.add_argument("--conditional-is-good", action="store_true", help="count conditional verdicts as good")
    golden = action("golden", "control charts of the golden units", _golden)
    add_shared(golden, "registry")
    golden.add_argument("--station", metavar="NAME")
    golden.add_argument("--serial")
    golden.add_argument("--baseline", **COUNT, help="limits from the first N checks (default: all)")


def _grr(options: argparse.Namespace) -> None:
    from softcal.app.registry.quality import gauge_study, study_json

    if options.tolerance is not None and not options.tolerance > 0:
        raise InputError(f"--tolerance {options.tolerance:g}: a positive width was expected")
    study = gauge_study(options.file, options.method)
    value = study_json(study)
    parts = [
        ("repeatability (EV)", study.repeatability),
        ("reproducibility (AV)", study.reproducibility),
        ("interaction", study.interaction),
        ("gauge R&R", study.grr),
        ("units (PV)", study.parts),
        ("total (TV)", study.total),
    ]
    header, rows = ["what", "standard deviation", "% of total"], [[n, s, 100 * s / study.total] for n, s in parts]
    if options.tolerance is not None:
        value["tolerance_percent"] = study.tolerance_percent(options.tolerance)
        header.append("% of tolerance")
        rows = [[*row, 600 * spread / options.tolerance] for row, (_, spread) in zip(rows, parts, strict=True)]
    closing = f"{study.word}: {study.grr_percent:.1f} % gauge R&R, {study.categories} distinct categories, 5 are wanted"
    answer(options, "quality.grr/1", value)
    print_table(header, rows)
    print(closing)


def _capability(options: argparse.Namespace) -> None:
    from dataclasses import asdict

    from softcal.app.registry.quality import chart_json, file_chart, lot_capability
    from softcal.core.quality.control_chart import capability

    if (options.lot is None) == (options.file is None):
        raise InputError("give either --lot ID or --file CSV --column NAME")
    if options.file is not None:
        if options.column is None:
            raise InputError("--file needs --column NAME")
        chart = file_chart(options.file, options.column)
        process = capability(chart, options.minimum, options.maximum)
    else:
        with registry_of(options) as registry:
            chart, process = lot_capability(registry, options.lot, options.maximum)
    value = {"capability": asdict(process), "chart": chart_json(chart)}
    row = [process.count, process.cp, process.cpk, process.cpk_lower, process.cpk_upper, process.pp, process.ppk]
    header = ["values", "Cp", "Cpk", "lower 95 %", "upper 95 %", "Pp", "Ppk"]
    answer(options, "quality.capability/1", value)
    print_table(header, [row])
    print("the process is stable")


def _yield(options: argparse.Namespace) -> None:
    from softcal.app.registry.quality import list_shares, lot_yields, yields_json

    with registry_of(options) as registry:
        yields = lot_yields(registry, options.lot, conditional_is_good=options.conditional_is_good)
    value = {"lot": options.lot} | yields_json(yields)
    rows = [[name.replace("_", " "), s.count, s.of, s.value, *s.interval] for name, s in list_shares(yields)]
    reasons = "; ".join(f"{count} x {reason}" for reason, count in yields.reasons[:5])
    header = ["yield", "good", "of", "share", "lower 95 %", "upper 95 %"]
    answer(options, "quality.yield/1", value)
    print_table(header, rows)
    if reasons:
        print(f"not good: {reasons}")


def _golden(options: argparse.Namespace) -> None:
    from softcal.app.registry.quality import chart_json, golden_charts

    with registry_of(options) as registry:
        charts = golden_charts(registry, options.station, options.serial, options.baseline)
    records = [
        dict(zip(("station", "lot", "serial"), key, strict=True)) | chart_json(chart) for key, chart in charts.items()
    ]
    header = ["station", "lot", "unit", "checks", "centre", "lower", "upper", "newest", "state"]
    rows = []
    for key, chart in charts.items():
        newest = chart.signals[-1] if chart.signals else None
        state = f"check {newest.index + 1}: {newest.text}" if newest else "in control"
        limits = (chart.centre, chart.lower, chart.upper)
        rows.append([*key, len(chart.values), *limits, float(chart.values[-1]), state])
    answer(options, "quality.golden/1", {"charts": records})
    print_table(header, rows)
