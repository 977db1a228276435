"""One page per diagnosis: where the twin is wrong, why, what fixing gains, what is next."""

import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go

from softcal.app.charts import gap as figures
from softcal.app.charts.gap import RunView
from softcal.app.charts.page import document, section, table
from softcal.app.paper.drawing import svg
from softcal.app.texts.reasons import Words
from softcal.app.views import gap

SHOWN_CAUSES = 10
OWN_KINDS = {"zero", "gain", "delay", "drift"}
BOLD = re.compile(r"\*\*(.+?)\*\*")
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


def gap_page(report: Mapping[str, Any], runs: Sequence[RunView], serial: str, say: Words) -> str:
    """Return the page of a diagnosis of a unit as HTML; `report` has schema `softcal.gap/1`."""
    say = gap.words_for(report, say)
    parts, asked = [_header(report, serial, say)], gap.mistake_rows(report, say)
    if report["verdict"] == "data":
        mistakes = _rows(asked, say("gap.data"), say)
        parts += [section(say("gap.data"), mistakes), section(say("gap.runs.plain"), *_traces(runs, say))]
    else:
        places = _rows(gap.place_rows(report, say), say("gap.where.none"), say)
        ranking = drawings(figures.ranking_figure(report, SHOWN_CAUSES, say))
        causes = _rows(gap.cause_rows(report, say)[:SHOWN_CAUSES], gap.no_cause_words(report, say), say)
        groups = "; ".join(_effects(group, say, "gap.or") for group in report["ambiguous_with"])
        ambiguous = _note(_told(say, "gap.ambiguous", group=groups) + ".") if groups else ""
        untold = "".join(f"<li>{escape(gap.begun(line))}</li>" for line in gap.untold_lines(report, say))
        gain = figures.gain_figure(report, say)
        why, proposed = escape(gap.why_next(report["next_experiment"] or {}, say)), gap.next_experiment(report)
        experiment = f"<p>{_told(say, 'gap.next.none')} {gap.begun(why)}</p>"
        if proposed is not None:
            name = escape(gap.pressed_name(str(proposed["profile"]), say))
            experiment = f"<div class='next'><b>{name}</b><p>{why}</p></div>"
        maps = drawings(*(figures.map_figure(runs, channel, say) for channel in figures.channels_of(runs)))
        parts += [
            *([section(say("gap.data.asked"), _rows(asked, "", say))] if asked else []),
            section(say("gap.where"), drawings(figures.chain_figure(report, say)), places, maps),
            section(say("gap.why"), ranking, causes, ambiguous),
            section(
                say("gap.gain"),
                _gain_words(report, say),
                _calibration_words(report, say),
                _gain_rows(report, runs, say),
                drawings(gain),
            ),
            *([section(say("gap.told"), f"<ul>{untold}</ul>")] if untold else []),
            section(say("gap.sure"), _hidden_words(report, say), drawings(figures.hidden_figure(report, say))),
            *([section(say("gap.left"), *_left(report["residual"], report, say))] if report.get("residual") else []),
            section(say("gap.next"), experiment),
            section(say("gap.runs"), *_traces(runs, say)),
        ]
    return document(say("gap.page.title", serial=serial), parts, STYLE, say("gap.page.lang"))


def drawings(*drawn: go.Figure | None) -> str:
    """Return figures one below the other, of which those that could not be drawn are left out."""
    return "".join(svg(figure) for figure in drawn if figure is not None)


def _gain_rows(report: Mapping[str, Any], runs: Sequence[RunView], say: Words) -> str:
    """Return the gap of every channel in its unit and as a share of its range."""
    rows = []
    for column in figures.channels_of(runs):
        channel, (times, unit) = report["gap"].get(figures.reported(column)), figures.unit_of(column)
        if not channel or channel["rmse_before"] is None:
            continue
        parts = [run.channels[column].measured for run in runs if column in run.channels]
        span = max(max(part.max() for part in parts) - min(part.min() for part in parts), 1e-300)
        row = {"channel": gap.channel_name(figures.reported(column), say)}
        for name, key in (("base", "rmse_before"), ("causes", "rmse_after"), ("floor", "noise_floor")):
            row[name] = f"{times * channel[key]:.3g} {unit} ({100 * channel[key] / span:.2g} %)"
        rows.append(row)
    return _rows(rows, "", say)


def _calibration_words(report: Mapping[str, Any], say: Words) -> str:
    """Return what the gap costs a calibration, where it was asked for."""
    if (errors := report.get("calibration")) is None:
        return ""
    newtons = {name: f"{errors[name]:.3g}" for name in ("base", "repaired", "rig")}
    return f"<p>{_told(say, 'gap.gain.calibration', run=errors['run'], **newtons)}</p>"


def _left(residual: Mapping[str, Any], report: Mapping[str, Any], say: Words) -> tuple[str, str]:
    """Describe what no cause explains by its empirical terms, where they hold on runs held back."""
    shrink = {name: _percent(residual["shrink"][name]) for name in ("held_out", "low", "high")}
    words = [_told(say, "gap.left.is", **shrink)]
    if residual["beside"]:
        causes = _effects(residual["beside"], say)
        words.append(_told(say, "gap.left.beside", causes=causes, without=_percent(residual["without"])))
    if "load_N" in residual:
        span = {name: f"{residual[name]:.3g}" for name in ("load_N", "depth_mm")}
        words.append(_told(say, "gap.left.span", **span))
    return f"<p>{' '.join(words)}</p>", _rows(gap.residual_rows(report, say), say("gap.left"), say)


def _rows(rows: Sequence[Mapping[str, str]], otherwise: str, say: Words) -> str:
    if not rows:
        return f"<p>{escape(otherwise)}</p>"
    cells = []
    for row in rows:
        shown = {name: escape(text) for name, text in row.items()}
        if share := row.get("share"):
            width = share.strip("<> ").replace(" ", "")
            shown["share"] = f"<div class='bar'><i style='width:{width}'></i><span>{escape(share)}</span></div>"
        cells.append(list(shown.values()))
    return table([say(f"gap.column.{name}") for name in rows[0]], cells)


def _told(say: Words, key: str, **values: str) -> str:
    """Return a text as HTML in which only what stands out is markup."""
    return BOLD.sub(r"<b>\1</b>", escape(say(key, **values)))


def _effects(effects: Sequence[str], say: Words, key: str = "gap.and") -> str:
    return gap.listed([gap.effect_name(effect, say) for effect in effects], key, say)


def _traces(runs: Sequence[RunView], say: Words) -> Iterable[str]:
    for column in figures.channels_of(runs):
        for key, figure in (
            ("gap.figure.compared", figures.compared_figure(runs, column, say)),
            ("gap.figure.trace", figures.trace_figure(runs, column, say)),
        ):
            title = _told(say, key, channel=gap.channel_name(figures.reported(column), say))
            yield f"<h3>{gap.begun(title)}</h3>{drawings(figure)}"


def _header(report: Mapping[str, Any], serial: str, say: Words) -> str:
    """Return the verdict, the causes, and what to know before reading on."""
    causes = ", ".join(f"**{cause}**" for cause in gap.named_causes(report, say))
    lines = [
        f"<p class='unit'>{_told(say, 'gap.page.unit', serial=serial)}</p>",
        f"<h1 class='{escape(report['verdict'])}'>{_told(say, 'gap.verdict.' + report['verdict'])}</h1>",
        f"<p class='lead'>{_told(say, 'gap.page.causes', causes=causes)}</p>" if causes else "",
    ]
    if partial := report.get("partial"):
        effects, share = _effects(partial["effects"], say), _percent(partial["share"])
        lines.append(_note(_told(say, "gap.partial", causes=effects, share=share)))
    # What was taken off every run before it was compared, at most; nothing shows as 0.
    offsets = (_own_offsets if report.get("simulator") else _rig_offsets)(report.get("offsets", ()), say)
    if offsets:
        lines.append(_note(_told(say, "gap.own", offsets="; ".join(offsets))))
    # Noise that is not white; the floor holds it.
    sentences = []
    for channel, noise in report.get("noise", {}).items():
        times, unit = figures.unit_of(channel)
        size, fading = f"{times * noise['fading']:.3g}", f"{noise['fading_s']:.2g}"
        name = gap.channel_name(channel, say)
        sentences.append(say("gap.noise.one", channel=name, size=size, unit=unit, fading=fading))
    if sentences:
        lines.append(_note(_told(say, "gap.noise", channels="; ".join(sentences))))
    if missing := report.get("missing_channels"):
        words = [_told(say, "gap.page.missing", channels=", ".join(missing))]
        if stages := ", ".join(gap.stage_name(stage, say) for stage in report.get("unseen_stages", ())):
            words.append(_told(say, "gap.page.unseen", stages=stages))
        lines.append(_note(" ".join(words)))
    return f"<header>{''.join(lines)}</header>"


def _note(words: str) -> str:
    return f"<p class='note'>{words}</p>"


def _rig_offsets(offsets: Sequence[Mapping[str, float]], say: Words) -> list[str]:
    sentences = []
    for name, scale, digits in (("force_N", 1.0, 3), ("resistance", 100.0, 2), ("seat_mm", 1000.0, 0)):
        size = f"{scale * max((abs(run[name]) for run in offsets), default=0.0):.{digits}f}"
        if float(size):
            sentences.append(say(f"gap.own.{name}", size=size))
    return sentences


def _own_offsets(offsets: Sequence[Mapping[str, Any]], say: Words) -> list[str]:
    most: dict[tuple[str, str], float] = {}
    for offset in offsets:
        for kind in OWN_KINDS & offset.keys():
            key = (offset["channel"], kind)
            most[key] = max(most.get(key, 0.0), abs(offset[kind]))
    named = ((gap.channel_name(channel, say), kind, size) for (channel, kind), size in sorted(most.items()))
    return [f"{channel}: {say(f'gap.own.{kind}')} {size:.3g}" for channel, kind, size in named]


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def _gain_words(report: Mapping[str, Any], say: Words) -> str:
    shrink = report["shrink"]
    if shrink.get("predicted") is None:
        return f"<p>{_told(say, 'gap.gain.none')}</p>"
    interval = say("gap.range", low=_percent(shrink.get("low")), high=_percent(shrink.get("high")))
    words = [_told(say, "gap.gain.is", predicted=_percent(shrink["predicted"]), range=interval)]
    if shrink.get("held_out") is not None:
        words.append(_told(say, "gap.gain.held_out", held_out=_percent(shrink["held_out"])))
    if len(parts := shrink.get("chosen", [])) > 0:
        same = sum(causes == max(parts, key=parts.count) for causes in parts)
        words.append(_told(say, "gap.gain.chosen", same=str(same), parts=str(len(parts))))
    return f"<p>{' '.join(words)}</p>"


def _hidden_words(report: Mapping[str, Any], say: Words) -> str:
    if not (hidden := gap.hidden_effects(report, say)):
        return f"<p>{_told(say, 'gap.hidden.bars')}</p>"
    return _note(_told(say, "gap.hidden.most", effects=", ".join(hidden)))
