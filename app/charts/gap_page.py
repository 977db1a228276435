"""One page per diagnosis: where the twin is wrong, why, what fixing gains, what is next."""

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go

from softcal.app.charts import gap as figures
from softcal.app.charts.page import document, section, table
from softcal.app.paper.drawing import svg
from softcal.app.texts.reasons import Translator
from softcal.app.views import gap
from softcal.app.views.common import percent
from softcal.app.views.gap_runs import RunView

MAX_CAUSES = 10
OFFSET_KINDS = {"zero", "gain", "delay", "drift"}
BOLD_MARKUP = re.compile(r"\*\*(.+?)\*\*")
"""How the texts mark what stands out: the desk reads the same ones as Markdown."""


STYLE = """h1 { padding-left: 14px; border-left: 6px solid #5b6573; }
h1.no_gap { border-color: #1b7f4d; } h1.data { border-color: #b3261e; } h1.explained { border-color: #0b5cad; }
h1.ambiguous, h1.explained_in_part { border-color: #b06f00; } h1.unknown { border-color: #b3261e; }
.unit { margin: 0; color: #55606c; } .lead { font-size: 17px; margin: 6px 0; }
.note { background: #fff6e0; border: 1px solid #ecd9a6; border-radius: 6px; padding: 8px 12px; }
.next { background: #eaf3fb; border: 1px solid #bcd7ee; border-radius: 6px; padding: 12px 16px; font-size: 16px; }
.next p { margin: 4px 0 0; }
.bar { position: relative; background: #eef1f4; border-radius: 4px; min-width: 110px; height: 22px; }
.bar i { position: absolute; inset: 0 auto 0 0; background: #eab69f; border-radius: 4px; }
.bar span { position: relative; padding-left: 6px; }
"""
"""Its colours are of the outcomes of a diagnosis, which are other words than a unit's verdicts (`charts.palette`)."""


def gap_page(report: Mapping[str, Any], runs: Sequence[RunView], serial: str, translate: Translator) -> str:
    """Return the page of a diagnosis of a unit as HTML; `report` has schema `softcal.gap/1`."""
    translate = gap.report_translator(report, translate)
    parts, mistake_rows = [_header(report, serial, translate)], gap.mistake_rows(report, translate)
    if report["verdict"] == "data":
        mistakes = _rows(mistake_rows, translate("gap.data"), translate)
        parts += [
            section(translate("gap.data"), mistakes),
            section(translate("gap.runs.plain"), *_traces(runs, translate)),
        ]
    else:
        parts.append(drawings(figures.worst_run_figure(runs, translate)))
        places = _rows(gap.location_rows(report, translate), translate("gap.where.none"), translate)
        ranking = drawings(figures.ranking_figure(report, MAX_CAUSES, translate))
        causes = _rows(gap.cause_rows(report, translate)[:MAX_CAUSES], gap.no_cause_text(report, translate), translate)
        groups = "; ".join(_effects(group, translate, "gap.or") for group in report["ambiguous_with"])
        ambiguous = _note(_markup(translate, "gap.ambiguous", group=groups) + ".") if groups else ""
        unidentifiable = "".join(
            f"<li>{escape(gap.capitalize(line))}</li>" for line in gap.unidentifiable_lines(report, translate)
        )
        gain = figures.gain_figure(report, translate)
        next_reason, proposed = (
            escape(gap.next_run_reason(report["next_experiment"] or {}, translate)),
            gap.next_experiment(report),
        )
        experiment = f"<p>{_markup(translate, 'gap.next.none')} {gap.capitalize(next_reason)}</p>"
        if proposed is not None:
            name = escape(gap.profile_name(str(proposed["profile"]), translate))
            experiment = f"<div class='next'><b>{name}</b><p>{next_reason}</p></div>"
        maps = drawings(*(figures.map_figure(runs, channel, translate) for channel in figures.channels_of(runs)))
        parts += [
            *([section(translate("gap.data.asked"), _rows(mistake_rows, "", translate))] if mistake_rows else []),
            section(translate("gap.where"), drawings(figures.chain_figure(report, translate)), places, maps),
            section(translate("gap.why"), ranking, causes, ambiguous),
            section(
                translate("gap.gain"),
                _gain_text(report, translate),
                _calibration_text(report, translate),
                _gain_rows(report, runs, translate),
                drawings(gain),
            ),
            *([section(translate("gap.told"), f"<ul>{unidentifiable}</ul>")] if unidentifiable else []),
            section(
                translate("gap.sure"),
                _hidden_text(report, translate),
                drawings(figures.hidden_figure(report, translate)),
            ),
            *(
                [section(translate("gap.left"), *_residual_parts(report["residual"], report, translate))]
                if report.get("residual")
                else []
            ),
            section(translate("gap.next"), experiment),
            section(translate("gap.runs"), *_traces(runs, translate)),
        ]
    return document(translate("gap.page.title", serial=serial), parts, STYLE, translate("gap.page.lang"))


def drawings(*optional_figures: go.Figure | None) -> str:
    """Return figures one below the other, of which those that could not be drawn are left out."""
    return "".join(svg(figure) for figure in optional_figures if figure is not None)


def _gain_rows(report: Mapping[str, Any], runs: Sequence[RunView], translate: Translator) -> str:
    """Return the gap of every channel in its unit and as a share of its range."""
    rows = []
    for column in figures.channels_of(runs):
        channel, (times, unit) = report["gap"].get(figures.report_name(column)), figures.unit_of(column)
        if not channel or channel["rmse_before"] is None:
            continue
        parts = [run.channels[column].measured for run in runs if column in run.channels]
        span = max(max(part.max() for part in parts) - min(part.min() for part in parts), 1e-300)
        row = {"channel": gap.channel_name(figures.report_name(column), translate)}
        for name, key in (("base", "rmse_before"), ("causes", "rmse_after"), ("floor", "noise_floor")):
            row[name] = f"{times * channel[key]:.3g} {unit} ({100 * channel[key] / span:.2g} %)"
        rows.append(row)
    return _rows(rows, "", translate)


def _calibration_text(report: Mapping[str, Any], translate: Translator) -> str:
    """Return what the gap costs a calibration, where it was asked for."""
    if (errors := report.get("calibration")) is None:
        return ""
    newtons = {name: f"{errors[name]:.3g}" for name in ("base", "repaired", "rig")}
    return f"<p>{_markup(translate, 'gap.gain.calibration', run=errors['run'], **newtons)}</p>"


def _residual_parts(residual: Mapping[str, Any], report: Mapping[str, Any], translate: Translator) -> tuple[str, str]:
    """Describe what no cause explains by its empirical terms, where they hold on runs held back."""
    explained_fractions = {name: percent(residual["shrink"][name]) for name in ("held_out", "low", "high")}
    texts = [_markup(translate, "gap.left.is", **explained_fractions)]
    if residual["beside"]:
        causes = _effects(residual["beside"], translate)
        texts.append(_markup(translate, "gap.left.beside", causes=causes, without=percent(residual["without"])))
    if "load_N" in residual:
        span = {name: f"{residual[name]:.3g}" for name in ("load_N", "depth_mm")}
        texts.append(_markup(translate, "gap.left.span", **span))
    return f"<p>{' '.join(texts)}</p>", _rows(gap.residual_rows(report, translate), translate("gap.left"), translate)


def _rows(rows: Sequence[Mapping[str, str]], otherwise: str, translate: Translator) -> str:
    if not rows:
        return f"<p>{escape(otherwise)}</p>"
    cells = []
    for row in rows:
        row_cells = {name: escape(text) for name, text in row.items()}
        if share := row.get("share"):
            width = share.strip("<> ").replace(" ", "")
            row_cells["share"] = f"<div class='bar'><i style='width:{width}'></i><span>{escape(share)}</span></div>"
        cells.append(list(row_cells.values()))
    return table([translate(f"gap.column.{name}") for name in rows[0]], cells)


def _markup(translate: Translator, key: str, **values: str) -> str:
    """Return a text as HTML in which only what stands out is markup."""
    return BOLD_MARKUP.sub(r"<b>\1</b>", escape(translate(key, **values)))


def _effects(effects: Sequence[str], translate: Translator, key: str = "gap.and") -> str:
    return gap.join_names([gap.effect_name(effect, translate) for effect in effects], key, translate)


def _traces(runs: Sequence[RunView], translate: Translator) -> Iterable[str]:
    for column in figures.channels_of(runs):
        for key, figure in (
            ("gap.figure.compared", figures.compared_figure(runs, column, translate)),
            ("gap.figure.trace", figures.trace_figure(runs, column, translate)),
        ):
            title = _markup(translate, key, channel=gap.channel_name(figures.report_name(column), translate))
            yield f"<h3>{gap.capitalize(title)}</h3>{drawings(figure)}"


def _header(report: Mapping[str, Any], serial: str, translate: Translator) -> str:
    """Return the verdict, the causes, and what to know before reading on."""
    causes = ", ".join(f"**{cause}**" for cause in gap.cause_names(report, translate))
    lines = [
        f"<p class='unit'>{_markup(translate, 'gap.page.unit', serial=serial)}</p>",
        f"<h1 class='{escape(report['verdict'])}'>{_markup(translate, 'gap.verdict.' + report['verdict'])}</h1>",
        f"<p class='lead'>{_markup(translate, 'gap.page.causes', causes=causes)}</p>" if causes else "",
    ]
    if partial := report.get("partial"):
        effects, share = _effects(partial["effects"], translate), percent(partial["share"])
        lines.append(_note(_markup(translate, "gap.partial", causes=effects, share=share)))
    # What was taken off every run before it was compared, at most; nothing shows as 0.
    offsets = (_simulator_offsets if report.get("simulator") else _rig_offsets)(report.get("offsets", ()), translate)
    if offsets:
        lines.append(_note(_markup(translate, "gap.own", offsets="; ".join(offsets))))
    # Noise that is not white; the floor holds it.
    sentences = []
    for channel, noise in report.get("noise", {}).items():
        times, unit = figures.unit_of(channel)
        size, fading = f"{times * noise['fading']:.3g}", f"{noise['fading_s']:.2g}"
        name = gap.channel_name(channel, translate)
        sentences.append(translate("gap.noise.one", channel=name, size=size, unit=unit, fading=fading))
    if sentences:
        lines.append(_note(_markup(translate, "gap.noise", channels="; ".join(sentences))))
    if missing := report.get("missing_channels"):
        texts = [_markup(translate, "gap.page.missing", channels=", ".join(missing))]
        if stages := ", ".join(gap.stage_name(stage, translate) for stage in report.get("unseen_stages", ())):
            texts.append(_markup(translate, "gap.page.unseen", stages=stages))
        lines.append(_note(" ".join(texts)))
    return f"<header>{''.join(lines)}</header>"


def _note(html: str) -> str:
    return f"<p class='note'>{html}</p>"


def _rig_offsets(offsets: Sequence[Mapping[str, float]], translate: Translator) -> list[str]:
    sentences = []
    for name, scale, digits in (("force_N", 1.0, 3), ("resistance", 100.0, 2), ("seat_mm", 1000.0, 0)):
        size = f"{scale * max((abs(run[name]) for run in offsets), default=0.0):.{digits}f}"
        if float(size):
            sentences.append(translate(f"gap.own.{name}", size=size))
    return sentences


def _simulator_offsets(offsets: Sequence[Mapping[str, Any]], translate: Translator) -> list[str]:
    largest: dict[tuple[str, str], float] = {}
    for offset in offsets:
        for kind in OFFSET_KINDS & offset.keys():
            key = (offset["channel"], kind)
            largest[key] = max(largest.get(key, 0.0), abs(offset[kind]))
    items = ((gap.channel_name(channel, translate), kind, size) for (channel, kind), size in sorted(largest.items()))
    return [f"{channel}: {translate(f'gap.own.{kind}')} {size:.3g}" for channel, kind, size in items]


def _gain_text(report: Mapping[str, Any], translate: Translator) -> str:
    explained_fractions = gap.explained_fractions(report)
    if explained_fractions.get("predicted") is None:
        return f"<p>{_markup(translate, 'gap.gain.none')}</p>"
    interval = translate(
        "gap.range", low=percent(explained_fractions.get("low")), high=percent(explained_fractions.get("high"))
    )
    texts = [_markup(translate, "gap.gain.is", predicted=percent(explained_fractions["predicted"]), range=interval)]
    if explained_fractions.get("held_out") is not None:
        texts.append(_markup(translate, "gap.gain.held_out", held_out=percent(explained_fractions["held_out"])))
    if len(parts := explained_fractions.get("chosen", [])) > 0:
        same = sum(causes == max(parts, key=parts.count) for causes in parts)
        texts.append(_markup(translate, "gap.gain.chosen", same=str(same), parts=str(len(parts))))
    return f"<p>{' '.join(texts)}</p>"


def _hidden_text(report: Mapping[str, Any], translate: Translator) -> str:
    if not (hidden := gap.hidden_effects(report, translate)):
        return f"<p>{_markup(translate, 'gap.hidden.bars')}</p>"
    return _note(_markup(translate, "gap.hidden.most", effects=", ".join(hidden)))
