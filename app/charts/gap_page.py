"""One page per diagnosis: where the twin is wrong, why, what it gains to fix it, how sure that is, what to press next.

A standalone HTML file: the plotting library is inside, nothing is loaded from elsewhere.
"""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from softcal.app.charts.gap import (
    CHANNEL_WORDS,
    RunView,
    gain_figure,
    hidden_figure,
    map_figure,
    ranking_figure,
    trace_figure,
)

CHAIN = ("motion", "mechanics", "transduction", "electronics", "acquisition")
WORDS = {
    "no_gap": "The twin agrees with the rig as far as these recordings can show.",
    "explained": "The gap is explained.",
    "ambiguous": "The gap is located, but these recordings cannot tell its causes apart.",
    "unknown": "A structured gap is left that nothing in the catalogue explains.",
    "data": "The recordings hold a mistake. Repair it and diagnose again; nothing else was judged.",
}
SHOWN_CAUSES = 10


def gap_page(report: Mapping[str, Any], runs: Sequence[RunView], serial: str) -> str:
    """Return the page of a diagnosis as HTML.

    Args:
        report: the record of a diagnosis, schema `softcal.gap/1`.
        runs: measured and predicted channels of every run, before and after.
        serial: unit of the case.
    """
    if report["verdict"] == "data":
        parts = [_headline(report, serial), _section("What is wrong with the recordings", _mistakes(report))]
        return _document(serial, [*parts, _section("Run by run", *_traces(runs))])
    return _document(
        serial,
        [
            _headline(report, serial),
            _section("Where the twin is wrong", chain_svg(report), _places(report["where"]), *_maps(runs)),
            _section("Why", _figure(ranking_figure(report, SHOWN_CAUSES)), _causes(report), _ambiguity(report)),
            _section("What it gains to fix it", _gain_words(report), _figure(gain_figure(report))),
            _section("How sure this is", _hidden_words(report), *_optional(hidden_figure(report))),
            _section("What to press next", _next(report["next_experiment"])),
            _section("Before and after, run by run", *_traces(runs)),
        ],
    )


def _mistakes(report: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{escape(_words(d['what']))}</td><td>{escape(d['channel'])}</td>"
        f"<td>{escape('all' if d['runs'] == 'all' else ', '.join(map(str, d['runs'])))}</td>"
        f"<td>{escape(d['evidence'])}</td><td>{escape(d['repair'])}</td></tr>"
        for d in report["data"]
    )
    heads = "".join(f"<th>{word}</th>" for word in ("mistake", "channel", "runs", "what shows it", "what repairs it"))
    return f"<table><tr>{heads}</tr>{rows}</table>"


def _document(serial: str, parts: Sequence[str]) -> str:
    body = "\n".join(parts)
    return _DOCUMENT.format(title=escape(f"Gap of {serial}"), script=get_plotlyjs(), body=body)


def _figure(figure: go.Figure) -> str:
    return str(
        figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "displayModeBar": False})
    )


def _optional(figure: go.Figure | None) -> Iterable[str]:
    return () if figure is None else (_figure(figure),)


def _maps(runs: Sequence[RunView]) -> Iterable[str]:
    figures = (map_figure(runs, channel) for channel in CHANNEL_WORDS)
    return (_figure(figure) for figure in figures if figure is not None)


def _traces(runs: Sequence[RunView]) -> Iterable[str]:
    for channel, word in CHANNEL_WORDS.items():
        figure = trace_figure(runs, channel)
        if figure is not None:
            yield f"<h3>{word.capitalize()}, measured − predicted</h3>{_figure(figure)}"


def _section(title: str, *parts: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def _headline(report: Mapping[str, Any], serial: str) -> str:
    named = [cause for cause in report["causes"] if cause["probability"] >= 0.5]
    names = ", ".join(f"<b>{escape(_words(c['effect']))}</b> ({_percent(c['probability'])})" for c in named)
    missing = ", ".join(map(escape, report["missing_channels"]))
    lines = [
        f"<p class='unit'>Unit {escape(serial)}</p>",
        f"<h1 class='{escape(report['verdict'])}'>{escape(WORDS[report['verdict']])}</h1>",
        f"<p class='lead'>Cause: {names}.</p>" if names else "",
        _partly(report),
        _offsets(report),
        _noise(report),
        f"<p class='note'>Not recorded: {missing}.{_unseen(report)}</p>" if missing else "",
    ]
    return f"<header>{''.join(lines)}</header>"


def _partly(report: Mapping[str, Any]) -> str:
    found = report.get("partial")
    if not found:
        return ""
    names = " and ".join(escape(_words(effect)) for effect in found["effects"])
    return f"<p class='note'>Nearest, a partial explanation: {names}, {_percent(found['share'])} of the gap.</p>"


def _offsets(report: Mapping[str, Any]) -> str:
    """Say what was taken off every run before anything was compared, at most in size."""
    most = {
        name: max((abs(one[name]) for one in report.get("offsets", ())), default=0.0)
        for name in ("force_N", "resistance", "seat_mm")
    }
    if not any(most.values()):
        return ""
    return (
        f"<p class='note'>Taken off run by run: a load at rest of up to {most['force_N']:.3f} N, an unloaded "
        f"resistance that differs by up to {100 * most['resistance']:.2f} %, a surface that differs by up to "
        f"{1e3 * most['seat_mm']:.0f} µm.</p>"
    )


def _noise(report: Mapping[str, Any]) -> str:
    """Say which channels have noise that is not white, and that the floor holds it."""
    units = {"output": (1e3, "mV"), "force": (1e3, "mN")}
    told = [
        f"{_words(channel)} {units[channel][0] * found['fading']:.1f} {units[channel][1]}, "
        f"fading within {found['fading_s']:.2g} s"
        for channel, found in report.get("noise", {}).items()
        if channel in units
    ]
    return f"<p class='note'>Noise that is not white, part of the floor: {'; '.join(told)}.</p>" if told else ""


def _unseen(report: Mapping[str, Any]) -> str:
    stages = ", ".join(escape(_words(stage)) for stage in report.get("unseen_stages", ()))
    return f" Not judged without them: {stages}." if stages else ""


def _words(identifier: str) -> str:
    return identifier.replace("_", " ")


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.0f} %"


def chain_svg(report: Mapping[str, Any]) -> str:
    """Return the chain from motion to acquisition as SVG; the darker a stage, the more of the gap sits there."""
    shares: dict[str, float] = {}
    for place in report["where"]:
        # Stages come first; the rows after them tell the regime, whose share is one of energy.
        shares.setdefault(place["stage"], float(place["share"]))
    unseen = report.get("unseen_stages", ())
    boxes = [_box(stage, 10 + 172 * k, 14, shares.get(stage, 0.0), unseen) for k, stage in enumerate(CHAIN)]
    arrows = [f"<path d='M{156 + 172 * k} 44 h22' marker-end='url(#tip)'/>" for k in range(len(CHAIN) - 1)]
    cell = _box("load_cell", 354, 108, shares.get("load_cell", 0.0), unseen)
    return (
        "<svg class='chain' viewBox='0 0 868 180' role='img' aria-label='Share of the gap by stage of the chain'>"
        "<defs><marker id='tip' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' markerHeight='7' orient='auto'>"
        "<path d='M0 0L8 4L0 8z' fill='#5b6573' stroke='none'/></marker></defs>"
        f"<g stroke='#5b6573' stroke-width='1.6' fill='none'>{''.join(arrows)}"
        f"<path d='M255 74 V138 H348' marker-end='url(#tip)'/></g>{''.join(boxes)}{cell}</svg>"
    )


def _box(stage: str, x: int, y: int, share: float, unseen: Sequence[str]) -> str:
    share = min(1.0, max(0.0, share))
    fill = f"rgba(196,68,28,{0.06 + 0.84 * share:.2f})" if share > 0 else "#f3f5f7"
    ink = "#ffffff" if share > 0.55 else "#1c2733"
    label = _percent(share) if share > 0 else ("not judged" if stage in unseen else "no gap seen")
    return (
        f"<g><rect x='{x}' y='{y}' width='146' height='60' rx='8' fill='{fill}' stroke='#aab3bd'/>"
        f"<text x='{x + 73}' y='{y + 26}' text-anchor='middle' fill='{ink}' font-weight='600'>{_words(stage)}</text>"
        f"<text x='{x + 73}' y='{y + 46}' text-anchor='middle' fill='{ink}'>{label}</text></g>"
    )


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{cell}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _places(places: Sequence[Mapping[str, Any]]) -> str:
    if not places:
        return "<p>No part of the chain stands out of the noise.</p>"
    rows = [
        (
            escape(_words(p["stage"])),
            escape(str(p["channel"])),
            escape(str(p["regime"])),
            _bar(float(p["share"])),
            escape(str(p["detail"])),
        )
        for p in places
    ]
    return _table(("stage", "channel", "regime", "share of the gap", "what is seen"), rows)


def _bar(share: float) -> str:
    width = 100 * min(1.0, max(0.0, share))
    return f"<div class='bar'><i style='width:{width:.0f}%'></i><span>{_percent(share)}</span></div>"


def _causes(report: Mapping[str, Any]) -> str:
    ranked = sorted(report["causes"], key=lambda cause: -cause["probability"])
    likely = [cause for cause in ranked if cause["probability"] >= 0.05][:SHOWN_CAUSES]
    if not likely:
        return "<p>No effect of the catalogue is needed to explain these recordings.</p>"
    rows = [
        (
            escape(_words(cause["effect"])),
            _percent(cause["probability"]),
            _percent(cause["shrink"]),
            "<br>".join(_parameter(name, value) for name, value in cause["parameters"].items()),
        )
        for cause in likely
    ]
    return _table(("effect", "probability", "shrink of the gap", "fitted values, 90 % interval"), rows)


def _parameter(name: str, fitted: Mapping[str, Any]) -> str:
    unit = escape(str(fitted.get("unit") or ""))
    interval = (
        f" ({fitted['low']:.3g} to {fitted['high']:.3g})"
        if fitted.get("low") is not None and fitted.get("high") is not None
        else ""
    )
    value = "–" if fitted.get("value") is None else f"{fitted['value']:.4g}"
    return f"{escape(name)} = {value} {unit}{interval}"


def _ambiguity(report: Mapping[str, Any]) -> str:
    groups = [" or ".join(escape(_words(effect)) for effect in group) for group in report["ambiguous_with"]]
    if not groups:
        return ""
    return f"<p class='note'>These recordings cannot tell apart: {'; '.join(groups)}.</p>"


def _gain_words(report: Mapping[str, Any]) -> str:
    shrink = report["shrink"]
    if shrink.get("predicted") is None:
        return "<p>No forecast: there is no gap to shrink, or no explanation to shrink it with.</p>"
    interval = f"{_percent(shrink.get('low'))} to {_percent(shrink.get('high'))}"
    held_out = shrink.get("held_out")
    seen = "" if held_out is None else f" On samples that no fit has seen it shrinks by <b>{_percent(held_out)}</b>."
    return (
        f"<p>With these causes in the twin the gap is forecast to shrink by <b>{_percent(shrink['predicted'])}</b> "
        f"({interval}), counted from the refitted base down to the noise floor.{seen}</p>"
    )


def _hidden_words(report: Mapping[str, Any]) -> str:
    named = {cause["effect"] for cause in report["causes"] if cause["probability"] >= 0.05}
    hidden = {effect: share for effect, share in report["hidden_fraction"].items() if share is not None}
    worst = sorted((effect for effect in named if hidden.get(effect, 0.0) >= 0.8), key=lambda effect: -hidden[effect])
    if not worst:
        return (
            "<p>The bars show how much of each effect the refitted base parameters would swallow on these runs: "
            "what is swallowed cannot be seen.</p>"
        )
    names = ", ".join(f"{escape(_words(effect))} ({_percent(hidden[effect])})" for effect in worst)
    return (
        f"<p class='note'>On these runs the refitted base parameters swallow most of {names}. "
        "The size of such an effect rests on the small part that is left.</p>"
    )


def _next(experiment: Mapping[str, Any] | None) -> str:
    if not experiment or experiment.get("profile") in (None, "", "none"):
        return f"<p>No further run is proposed. {escape(str((experiment or {}).get('why', '')).capitalize())}</p>"
    return (
        f"<div class='next'><b>{escape(_words(str(experiment['profile'])))}</b>"
        f"<p>{escape(str(experiment.get('why', '')))}</p></div>"
    )


_DOCUMENT = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; color: #1c2733;
  background: #eef1f4; margin: 0; }}
main {{ max-width: 1080px; margin: 0 auto; padding: 24px 16px 64px; }}
header, section {{ background: #fff; border: 1px solid #d8dee4; border-radius: 10px; padding: 18px 24px;
  margin: 0 0 16px; }}
h1 {{ font-size: 26px; line-height: 1.25; margin: 2px 0 8px; padding-left: 14px; border-left: 6px solid #5b6573; }}
h1.no_gap {{ border-color: #1b7f4d; }} h1.data {{ border-color: #b3261e; }} h1.explained {{ border-color: #0b5cad; }}
h1.ambiguous {{ border-color: #b06f00; }} h1.unknown {{ border-color: #b3261e; }}
h2 {{ font-size: 18px; margin: 0 0 10px; }} h3 {{ font-size: 15px; margin: 12px 0 0; }}
.unit {{ margin: 0; color: #55606c; }} .lead {{ font-size: 17px; margin: 6px 0; }}
.note {{ background: #fff6e0; border: 1px solid #ecd9a6; border-radius: 6px; padding: 8px 12px; }}
.next {{ background: #eaf3fb; border: 1px solid #bcd7ee; border-radius: 6px; padding: 12px 16px; font-size: 16px; }}
.next p {{ margin: 4px 0 0; }}
.chain {{ width: 100%; height: auto; font-size: 14px; }}
table {{ border-collapse: collapse; width: 100%; margin: 8px 0; font-size: 14px; }}
th, td {{ text-align: left; padding: 6px 10px; border-bottom: 1px solid #e4e8ec; vertical-align: top; }}
th {{ color: #55606c; font-weight: 600; }}
.bar {{ position: relative; background: #eef1f4; border-radius: 4px; min-width: 110px; height: 22px; }}
.bar i {{ position: absolute; inset: 0 auto 0 0; background: #eab69f; border-radius: 4px; }}
.bar span {{ position: relative; padding-left: 6px; }}
</style>
<script>{script}</script>
</head><body><main>{body}</main></body></html>
"""
