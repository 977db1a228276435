"""What audits buy: lots whose truth is outside what the method was set on, released on 0 to 20 audited units.

python benchmarks/trust.py [--quick] [--seeds FIRST LAST] [--cache DIR] [--measured | --days | --power
    | --golden] [--figure FILE]

Each lot is fitted once and kept in the cache; which units are audited is drawn many times over. A release keeps the
promise of `softcal lot release`: no more than the risk of the released units beyond the limit, at 90 % confidence.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import gettempdir

import numpy as np
from common.command import parser_of
from common.map_methods import SOURCES
from common.screens import write_figure
from common.tables import print_table
from common.trust_golden import print_golden
from common.trust_lots import GOOD, FittedUnit, covered, day_lots, drawn_lots, fitted, measured_lots, power_lots
from plotly.subplots import make_subplots
from scipy.stats import beta

from softcal.core.quality.acceptance import min_risk
from softcal.core.quality.interval_inflation import fit_interval_inflation
from softcal.core.quality.release import AuditedUnit, min_passing, release
from softcal.core.unit.correspondence import ANCHORED
from softcal.core.unit.line_spread import LineSpread
from softcal.core.unit.lot_correction import LotCorrection
from softcal.core.unit.method import LineConfig, Method, ReleaseConfig
from softcal.core.unit.uncertainty import IntervalInflation
from softcal.core.unit.verdict import Limit

AUDITS = (0, 3, 5, 10, 20)
DRAWS = 20
RISK = 0.10
Lots = Mapping[tuple[str, str], Sequence[FittedUnit]]


@dataclass(frozen=True)
class Draw:
    """One lot released on one draw of its audits.

    Args:
        unmeasured, good: units nobody measured, and how many of them are within the limit.
        released, beyond: how many were released, and how many of these are beyond the limit.
        coverage, released_coverage: of the scaled 90 % interval, of every unmeasured and of every released unit.
    """

    unmeasured: int
    good: int
    released: int
    beyond: int
    coverage: tuple[float, ...]
    released_coverage: tuple[float, ...]


def main() -> None:
    parser = parser_of(__doc__, "one lot of each kind")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 24), metavar=("FIRST", "LAST"))
    parser.add_argument("--cache", type=Path, default=Path(gettempdir()) / "softcal-trust", help="fits are kept here")
    parser.add_argument("--measured", action="store_true", help="the recordings of shared/data in place of drawn lots")
    parser.add_argument("--days", action="store_true", help="lots read on another day, without and with a golden run")
    parser.add_argument("--power", action="store_true", help="lots whose audits or known loads show what differs")
    parser.add_argument("--figure", type=Path, help="draw what audits buy: .html, or .png by chromium")
    parser.add_argument("--golden", action="store_true", help="taxels of the insole behind a golden run of another day")
    options = parser.parse_args()
    if options.golden:
        print_golden(SOURCES[:1] if options.quick else SOURCES, options.cache)
        return
    if options.measured:
        report(by_lot(fitted(measured_lots, "measured", options.cache)))
        return
    seeds = range(1) if options.quick else range(*options.seeds)
    if options.days:
        fits = (fitted(lambda seed=seed: day_lots(seed), f"days-{seed}", options.cache) for seed in seeds)  # type: ignore[misc]
        report(by_lot(unit for units in fits for unit in units))
        return
    if options.power:
        fits = (fitted(lambda seed=seed: power_lots(seed), f"power-{seed}", options.cache) for seed in seeds)  # type: ignore[misc]
        print_power(by_lot(unit for units in fits for unit in units))
        return
    units = [u for seed in seeds for u in fitted(lambda seed=seed: drawn_lots(seed), f"seed-{seed}", options.cache)]  # type: ignore[misc]
    lots = by_lot(units)
    report(lots)
    if options.figure:
        draw_figure(lots, options.figure)


def report(lots: Lots) -> None:
    print(f"{len(lots)} lots, {sum(map(len, lots.values()))} units; {DRAWS} draws of the audits each\n")
    print_without_audits(lots)
    print_kinds(lots, 10)
    print_audits(lots)
    print_deciles(lots)
    print_line(lots)


def by_lot(units: Iterable[FittedUnit]) -> Lots:
    lots: dict[tuple[str, str], list[FittedUnit]] = {}
    for unit in units:
        lots.setdefault((unit.kind, unit.lot), []).append(unit)
    return lots


def released_on(lots: Lots, audits: int, draws: int = DRAWS, risk: float = RISK) -> dict[str, list[Draw]]:
    """Release every lot on this many audits, drawn `draws` times; a lot with nothing left over is left out."""
    rng, draws_by_kind = np.random.default_rng(0), dict[str, list[Draw]]()
    for (kind, _), units in lots.items():
        candidates = [u for u in units if not u.is_vetoed]
        for _ in range(draws):
            order = rng.permutation(len(candidates))
            audited, rest = ([candidates[k] for k in part] for part in (order[:audits], order[audits:]))
            # Units with a finding against them are not released; they count as unmeasured all the same.
            others = len(units) - len(candidates)
            if rest or others:
                draws_by_kind.setdefault(kind, []).append(_draw(audited, rest, others, ReleaseConfig(risk=risk)))
    return draws_by_kind


def _draw(audited: Sequence[FittedUnit], rest: Sequence[FittedUnit], others: int, config: ReleaseConfig) -> Draw:
    audited, rest = _corrected(audited, rest)
    within_limit = sum(u.truth <= u.limit for u in audited)
    decision = release(
        {u.serial: u.forecast for u in rest},
        [AuditedUnit(u.serial, u.forecast, u.truth) for u in audited],
        Limit("N", next((u.limit for u in rest), 1.0)),
        config,
        min_passing(len(audited) + len(rest) + others, within_limit, config),
    )
    released = [u for u in rest if u.serial in decision.released]
    inflation = fit_interval_inflation([u.samples for u in audited], 0.9, config) if audited else IntervalInflation()
    share = {u.serial: covered(u, inflation) for u in rest}
    return Draw(
        len(rest) + others,
        sum(u.truth <= u.limit for u in rest),
        len(released),
        sum(u.truth > u.limit for u in released),
        tuple(share.values()),
        tuple(share[u.serial] for u in released),
    )


def _corrected(
    audited: Sequence[FittedUnit], rest: Sequence[FittedUnit]
) -> tuple[Sequence[FittedUnit], Sequence[FittedUnit]]:
    """Take off what the audited units misread alike, of each audited one by the others, where they are enough.

    softcal does it behind the map; here it is done to the estimates that were kept, over the whole audit.
    """
    lines = {u.serial: u.line for u in audited if u.sample and ANCHORED not in u.knowledge}
    correction = LotCorrection(1, lines)
    audited, rest = ([_corrected_unit(unit, correction) for unit in part] for part in (audited, rest))
    return audited, rest


def _corrected_unit(unit: FittedUnit, correction: LotCorrection) -> FittedUnit:
    common = correction.line_of(unit.serial, unit.level, Method().release.min_correction_audits)
    if common is None or not unit.sample or ANCHORED in unit.knowledge:
        return unit
    estimate, reference, half = np.array(unit.sample)
    estimate = (estimate - common.line.zero) / common.line.gain
    error = float(np.sqrt(np.mean((estimate - reference) ** 2)))
    return replace(unit, truth=error, sample=(tuple(estimate), tuple(reference), tuple(half)))


def print_without_audits(lots: Lots) -> None:
    """Print what a verdict says that rests on the forecast alone."""
    rows = []
    for kind in dict.fromkeys(kind for kind, _ in lots):
        units = [u for (k, _), group in lots.items() if k == kind for u in group]
        passed, mapped = [u for u in units if u.word == "pass"], [u for u in units if u.sample]
        ratio = np.exp(np.median([np.log(u.truth / u.forecast) for u in mapped]))
        beyond = sum(u.truth > u.limit for u in passed)
        cover = np.quantile([covered(u) for u in mapped], (0.1, 0.5))
        far = float(np.mean([u.truth > u.limit for u in units]))
        rows.append(
            (kind, len(units), percent(far), f"{beyond} of {len(passed)}", f"{ratio:.2f}", *map(percent, cover))
        )
    print("Without an audit:\n")
    head = ("kind", "units", "beyond the limit", "forecast within, truth beyond", "true / forecast, median")
    print_table((*head, "coverage, tenth-worst percentile", "coverage, median unit"), rows)


def print_kinds(lots: Lots, audits: int) -> None:
    """Print what is released, and wrongly, by kind of lot."""
    rows = []
    for kind, draws in released_on(lots, audits).items():
        released, beyond = sum(d.released for d in draws), sum(d.beyond for d in draws)
        unmeasured, good = sum(d.unmeasured for d in draws), sum(d.good for d in draws)
        rows.append(
            (
                kind,
                percent(released / unmeasured),
                percent((released - beyond) / good) if good else "–",
                percent(float(np.mean([d.released > 0 for d in draws]))),
                percent(beyond / released) if released else "–",
                upper(beyond, released),
                *quantiles([d.released_coverage for d in draws]),
            )
        )
    print(f"{audits} audits a lot, promise {percent(RISK)} at 90 %:\n")
    head = ("kind", "released", "of the good ones", "lots released", "released: beyond the limit", "upper 95 %")
    print_table((*head, "coverage of released, tenth-worst percentile", "median unit"), rows)


def print_power(lots: Lots) -> None:
    """Print what ten audits release where they, or known loads, show what no unlabelled recording does."""
    rows = []
    for kind, draws in released_on(lots, 10).items():
        released, beyond = sum(d.released for d in draws), sum(d.beyond for d in draws)
        good = sum(d.good for d in draws)
        fitted_good = [u.truth <= u.limit for (k, _), units in lots.items() if k == kind for u in units]
        rows.append(
            (
                kind,
                percent(float(np.mean(fitted_good))),
                percent(good / sum(d.unmeasured for d in draws)),
                percent((released - beyond) / good) if good else "–",
                percent(beyond / released) if released else "–",
                *quantiles([d.coverage for d in draws]),
            )
        )
    head = ("kind", "within the limit as fitted", "with ten audits", "of these released", "released: beyond the limit")
    print_table((*head, "coverage of all, tenth-worst percentile", "median unit"), rows)


def print_audits(lots: Lots) -> None:
    """Print what each number of audits buys: the promise it can keep, what is released, what is wrong among it."""
    rows = []
    for audits in AUDITS:
        risk = max(RISK, min_risk(audits)) if audits else RISK
        by_kind = released_on(lots, audits, risk=risk)
        draws = [d for group in by_kind.values() for d in group]
        good = [d for kind, group in by_kind.items() if kind in GOOD for d in group]
        released, beyond = sum(d.released for d in draws), sum(d.beyond for d in draws)
        shares = [sum(d.beyond for d in g) / max(sum(d.released for d in g), 1) for g in by_kind.values()]
        rows.append(
            (
                audits,
                percent(risk) if audits else "none",
                percent(released / sum(d.unmeasured for d in draws)),
                percent(sum(d.released - d.beyond for d in good) / max(sum(d.good for d in good), 1)),
                percent(beyond / released) if released else "–",
                f"{sum(share <= risk for share in shares)} of {len(shares)}",
                percent(max(shares)),
                *quantiles([d.released_coverage for d in draws]),
                *quantiles([d.coverage for d in draws]),
            )
        )
    print("What audits buy:\n")
    head = (
        "audits a lot",
        "risk promised",
        "released, all kinds",
        "good units of good lots",
        "released: beyond the limit",
    )
    kinds = ("kinds within the risk", "worst kind")
    print_table(
        (*head, *kinds, "coverage of released, 10 %", "median unit", "coverage of all, 10 %", "median unit"), rows
    )


def print_deciles(lots: Lots) -> None:
    """Print true over forecast error by decile of the forecast over the limit."""
    units = sorted((u for group in lots.values() for u in group if u.sample), key=lambda u: u.forecast / u.limit)
    rows = []
    for part in np.array_split(np.arange(len(units)), 10):
        chosen = [units[k] for k in part]
        ratio = np.quantile([u.truth / u.forecast for u in chosen], (0.1, 0.5, 0.9))
        rows.append(
            (f"{chosen[0].forecast / chosen[0].limit:.2f} to {chosen[-1].forecast / chosen[-1].limit:.2f}", *ratio)
        )
    print("True / forecast error by decile of the forecast, without audits:\n")
    print_table(
        ("forecast / limit", "10 %", "median", "90 %"), [(a, float(b), float(c), float(d)) for a, b, c, d in rows]
    )


def print_line(lots: Lots) -> None:
    """Print what a spread of the line that nobody stated would do to the forecasts, were it in them by default."""
    rows = []
    line = LineConfig()
    for share in (0.0, 0.02, LineSpread(line.load_spread, line.day_spread).share):
        wide = {key: [with_line(unit, share) for unit in units] for key, units in lots.items()}
        by_kind = released_on(wide, 10)
        for label, is_good in (("good lots", True), ("all other kinds", False)):
            draws = [d for kind, group in by_kind.items() if (kind in GOOD) == is_good for d in group]
            units = [u for (kind, _), g in wide.items() if (kind in GOOD) == is_good for u in g if u.sample]
            released, beyond = sum(d.released for d in draws), sum(d.beyond for d in draws)
            good = percent((released - beyond) / max(sum(d.good for d in draws), 1))
            within = sum(u.forecast <= u.limit for u in units)
            wrong = sum(u.forecast <= u.limit < u.truth for u in units)
            ratio = np.exp(np.median([np.log(u.truth / u.forecast) for u in units]))
            rows.append((percent(share), label, f"{within} of {len(units)}", wrong, f"{ratio:.2f}", good))
    print("A spread of the line in every forecast by default:\n")
    head = ("share of the load", "kinds", "forecast within the limit", "of these beyond it", "true / forecast, median")
    print_table((*head, "ten audits: good units released"), rows)


def with_line(unit: FittedUnit, share: float) -> FittedUnit:
    """Return a unit as it would be judged with this spread of the line in its forecast."""
    forecast = float(np.hypot(unit.forecast, share * unit.load))
    return replace(unit, forecast=forecast)


def upper(beyond: int, released: int) -> str:
    """Return the upper 95 % bound of a share, the draws of one lot taken as one."""
    count = released / DRAWS
    return percent(float(beta.ppf(0.95, beyond / DRAWS + 1, max(count - beyond / DRAWS, 1e-9)))) if released else "–"


def quantiles(coverage: Sequence[tuple[float, ...]]) -> tuple[str, str]:
    values = [value for group in coverage for value in group]
    return tuple(percent(v) for v in np.quantile(values, (0.1, 0.5))) if values else ("–", "–")  # type: ignore[return-value]


def percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def draw_figure(lots: Lots, file: Path) -> None:
    """Draw released and wrongly released share over the number of audits, good kinds and all others apart."""
    counts, traces = [n for n in AUDITS if n], []
    for is_good, label, colour in ((True, "good lots", "#1b7837"), (False, "all other kinds", "#b35806")):
        chosen = {key: units for key, units in lots.items() if (key[0] in GOOD) == is_good}
        runs = [[d for g in released_on(chosen, n, risk=max(RISK, min_risk(n))).values() for d in g] for n in counts]
        released = [sum(d.released for d in run) for run in runs]
        good = [100 * sum(d.released - d.beyond for d in run) / max(sum(d.good for d in run), 1) for run in runs]
        beyond = [100 * sum(d.beyond for d in run) / max(r, 1) for r, run in zip(released, runs, strict=True)]
        traces += [(1, counts, good, label, colour, "solid"), (2, counts, beyond, label, colour, "solid")]
    promised_pct = [100 * max(RISK, min_risk(n)) for n in counts]
    traces.append((2, counts, promised_pct, "risk promised", "#333333", "dash"))
    titles = ("released, % of the good unmeasured units", "beyond the limit, % of the released")
    figure = make_subplots(1, 2, subplot_titles=titles)
    for column, x, y, name, colour, dash in traces:
        line = {"color": colour, "dash": dash}
        figure.add_scatter(x=x, y=y, name=name, line=line, showlegend=column == 1 or dash == "dash", row=1, col=column)
    figure.update_xaxes(title_text="audits a lot").update_yaxes(rangemode="tozero").update_layout(
        template="simple_white"
    )
    write_figure(figure, file)


if __name__ == "__main__":
    main()
