"""The whole report of a diagnosis in the language of the screen: real diagnoses, drawn in Korean, hold no English."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from softcal.app.charts.gap import chain_figure
from softcal.app.charts.gap_page import gap_page
from softcal.app.gap.diagnose import run_views
from softcal.app.gap.page_cases import pack_diagnosis
from softcal.app.paper.drawing import svg
from softcal.app.texts.catalogue import text
from softcal.app.texts.reasons import render_reason
from softcal.app.views.gap import (
    ambiguous_groups,
    cause_names,
    cause_rows,
    effect_name,
    hidden_effects,
    location_rows,
    mistake_rows,
    next_run_reason,
    profile_name,
    residual_rows,
)
from softcal.core import profiles
from softcal.core.challenge.protocols import PROTOCOLS
from softcal.core.gap import case as recordings
from softcal.core.gap.case import Case, Run
from softcal.core.gap.diagnosis import Diagnosis
from softcal.core.gap.twin import diagnose
from softcal.core.gap.twin_reach import UNMODELLED_EFFECTS, WARM_DIVIDER, SET_UP_min
from softcal.core.messages.gap_sentences import GAP_SENTENCES
from softcal.core.messages.reason import Reason
from softcal.core.orders import RunState
from softcal.core.twin.catalogue import BUILTIN_EFFECTS
from softcal.core.twin.effects import Alias
from softcal.core.twin.empirical_terms import VARIABLES
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from softcal.db.connection import open_registry
from tests.layers import layered

English = Callable[[str], list[str]]
KOREAN, ENGLISH = partial(text, "ko"), partial(text, "en")
READOUT = ReadoutMetadata(vref_V=3.3, adc_bits=12, r_series_ohm=10.0, sample_rate_Hz=50.0)
BASE = BaseParameters(u0_mm=0.35, k1_N_mm=1.1, k3_N_mm3=0.1, kappa_per_N=0.06, sigma_force_N=0.015)
DEPTH_mm = 3.1


def press_runs(*effects: EffectSetting) -> list[Run]:
    """Four runs of a rig with these effects, by the profiles people press."""
    rng = np.random.default_rng(1)
    shapes = (
        profiles.ramps([DEPTH_mm] * 2, 0.6),
        profiles.ramps([DEPTH_mm] * 6, 4.0),
        profiles.steps_with_holds([1.2, 2.4, DEPTH_mm, 1.8], hold_s=4.0),
        profiles.random_presses(rng, 20.0, DEPTH_mm),
    )
    runs = []
    for k, shape in enumerate(shapes, 1):
        t_s, stage_mm = shape.sample(50.0)
        temperature_C = 22.0 + 3.0 * (1 - np.exp(-t_s / 10.0)) + 0.3 * np.sin(t_s / 3.0 + k)
        force_N, output_V = simulate(Twin(BASE, effects, READOUT), t_s, stage_mm, rng, temperature_C)
        runs.append(Run(str(k), t_s, READOUT, stage_mm, force_N, output_V, temperature_C, profile=shape.name))
    return runs


def drifting(run: Run) -> Run:
    assert run.output_V is not None
    codes = np.round((run.output_V + 4e-4 * run.elapsed_s) / READOUT.step_V)
    return replace(run, output_V=codes * READOUT.step_V)


def dragging(run: Run) -> Run:
    assert run.force_N is not None and run.stage_mm is not None
    return replace(run, force_N=run.force_N + 0.06 * run.stage_mm)


def in_kgf(run: Run) -> Run:
    assert run.force_N is not None
    return replace(run, force_N=run.force_N / 9.80665)


AGEING = EffectSetting("ageing_drift", {"gamma": 0.004, "tau": 60.0})
CASES: dict[str, tuple[str, Callable[[], list[Run]]]] = {
    "nothing": ("no_gap", press_runs),
    "a pad that relaxes": ("explained", lambda: press_runs(EffectSetting("stress_relaxation", {"g": 0.1, "tau": 5.0}))),
    "a bad contact": ("explained", lambda: press_runs(EffectSetting("dropped_samples", {}, ((6.0, 12),)))),
    "a warm channel": ("explained", lambda: press_runs(EffectSetting("thermal_drift", {"alpha": 0.002}))),
    "no thermometer": ("ambiguous", lambda: [replace(run, temperature_C=None) for run in press_runs(AGEING)]),
    "a drifting offset": ("unknown", lambda: list(map(drifting, press_runs()))),
    "a dragging cable": ("unknown", lambda: list(map(dragging, press_runs()))),
    "another unit of force": ("data", lambda: [run if run.name != "2" else in_kgf(run) for run in press_runs()]),
    "no stage": ("no_gap", lambda: [replace(run, stage_mm=None) for run in press_runs()]),
}


@pytest.fixture(scope="module", params=layered(CASES, ("nothing", "a warm channel", "no thermometer")))
def diagnosis(request: pytest.FixtureRequest) -> Diagnosis:
    verdict, runs = CASES[request.param]
    diagnosis = diagnose(Case("G1", tuple(runs())))
    assert diagnosis.verdict == verdict
    return diagnosis


@pytest.fixture(scope="module")
def report(diagnosis: Diagnosis) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(json.dumps(diagnosis.report(), allow_nan=False))
    return loaded


def visible_text(html: str) -> list[str]:
    """What a page shows: its text and its labels, without scripts, styles and what is drawn from data."""
    bare = re.sub(r"<(script|style)\b.*?</\1>", " ", html, flags=re.DOTALL)
    labels = re.findall(r"(?:aria-label|title|alt)='([^']*)'", bare)
    return [unescape(part) for part in [*re.split(r"<[^>]*>", bare), *labels] if part.strip()]


@pytest.fixture(scope="module")
def page(report: dict[str, Any], diagnosis: Diagnosis) -> str:
    return gap_page(report, run_views(diagnosis), "G1", KOREAN)


def test_the_standalone_page_is_korean(report: dict[str, Any], page: str, english_in: English) -> None:
    assert '<html lang="ko">' in page
    assert [part for part in visible_text(page) if english_in(part)] == []
    assert text("ko", "gap.data" if report["verdict"] == "data" else "gap.runs") in visible_text(page)


def test_the_figures_of_the_page_are_korean(report: dict[str, Any], page: str, english_in: English) -> None:
    # Over time, twice for every channel; with a diagnosis also a map for each, ranking and gain.
    channels = 1 if {"force_N", "stage_mm"} & set(report["missing_channels"]) else 2
    figures = re.findall(r"<svg class='drawing'.*?</svg>", page)
    assert len(figures) >= (2 * channels if report["verdict"] == "data" else 3 * channels + 2)
    for figure in figures:
        assert visible_text(figure) and [part for part in visible_text(figure) if english_in(part)] == []


def test_the_chain_and_the_tables_are_korean(report: dict[str, Any], english_in: English) -> None:
    labels = visible_text(svg(chain_figure(report, KOREAN)))
    assert labels and english_in(" ".join(labels)) == []
    tables = (cause_rows, location_rows, residual_rows, mistake_rows)
    cells = [cell for rows in tables for row in rows(report, KOREAN) for cell in row.values()]
    lines = [line for lines in (cause_names, hidden_effects, ambiguous_groups) for line in lines(report, KOREAN)]
    proposed = report["next_experiment"]
    lines.append(next_run_reason(proposed, KOREAN))
    if proposed["profile"] != "none":
        lines.append(profile_name(proposed["profile"], KOREAN))
    assert [cell for cell in [*cells, *lines] if english_in(cell)] == []


def test_the_page_gap_is_korean_and_hands_out_its_report(
    diagnosis: Diagnosis,
    calibrated: str,
    show: Any,
    english_in: English,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    case, offered = tmp_path / "rig-7", []
    (case / "runs").mkdir(parents=True)
    monkeypatch.setattr("streamlit.download_button", lambda *args, **options: offered.append((*args, options)))
    result, arrays = pack_diagnosis(diagnosis)
    with open_registry(calibrated) as registry:
        board = registry.job_board
        job = board.place("diagnose", {"case": str(case)}, "Erin")
        board.take(job)
        board.end(job, RunState.DONE, result["verdict"], result, arrays)
    screen = show(calibrated, "gap", case=str(case), lang="ko")
    assert not screen.exception
    kinds = ("header", "markdown", "caption", "warning", "error")
    texts = [one.value for kind in kinds for one in screen.get(kind)]
    texts += [str(cell) for table in screen.table for row in table.value.to_numpy() for cell in row]
    texts += [str(name) for table in screen.table for name in table.value.columns]
    of_the_page = [re.sub(r":material/\w+:", "", one) for one in texts]
    assert [one for one in of_the_page if english_in(one)] == []
    ((label, options),) = offered
    assert (label, options["file_name"]) == (KOREAN("gap.page.save"), "rig-7-gap.html")
    assert '<html lang="ko">' in options["data"]()


def test_the_english_sentences_of_a_report_stay_beside_their_codes(report: dict[str, Any]) -> None:
    for location in report["where"]:
        assert [str(Reason.parse(one)) for one in location["reasons"]] == [location["regime"], location["detail"]]
    (why,) = report["next_experiment"]["reasons"]
    assert str(Reason.parse(why)) == report["next_experiment"]["why"]


def test_a_report_of_an_older_version_is_shown_as_it_stands() -> None:
    location = {"stage": "mechanics", "channel": "force", "regime": "hold", "share": 0.5, "detail": "maps: stage→force"}
    (row,) = location_rows({"where": [location]}, KOREAN)
    texts = (KOREAN("gap.stage.mechanics"), KOREAN("gap.channel.force"), "hold", "maps: stage→force")
    assert (row["stage"], row["channel"], row["regime"], row["detail"]) == texts
    assert next_run_reason({"profile": "rest", "why": "it rests"}, KOREAN) == "it rests"
    assert next_run_reason({}, KOREAN) == ""


def test_what_a_plug_in_brings_is_shown_as_it_is_written() -> None:
    assert effect_name("cable_drag", KOREAN) == "cable drag"
    alias = Alias("electronics", "a loose plug", 0.5, "rest", "temperature_C", 1.0, "press the plug home")
    reasons = {"alias": Reason.parse(alias.detail), "advice": Reason.parse(alias.advice)}
    assert "a loose plug" in render_reason(Reason("gap.next.alias", {"effect": "cable_drag", **reasons}), KOREAN)
    assert profile_name("my own dance", KOREAN) == "my own dance"


def test_every_effect_has_its_names(english_in: English) -> None:
    for effect in BUILTIN_EFFECTS.values():
        assert effect_name(effect.id, ENGLISH) == effect.id.replace("_", " ")
        fitted = {p.name: {"value": 1.0, "low": 0.9, "high": 1.1, "unit": p.unit} for p in effect.parameters}
        cause = {"effect": effect.id, "stage": effect.stage, "probability": 1.0, "shrink": 1.0, "parameters": fitted}
        (row,) = cause_rows({"causes": [cause]}, KOREAN)
        assert english_in(" ".join(row.values())) == []
        forms = [text("ko", f"gap.form.{form.effect.equation}") for form in effect.forms]
        assert english_in(" ".join(forms)) == []


def test_everything_softcal_names_has_a_korean_name(english_in: English) -> None:
    assert english_in(" ".join(text("ko", f"gap.variable.{name}") for name in VARIABLES)) == []
    kinds = recordings.Kind.__args__  # type: ignore[attr-defined]
    assert english_in(" ".join(text("ko", f"gap.mistake.{kind}") for kind in kinds)) == []
    rng = np.random.default_rng(1)
    profile_names = [make(rng, 3.0).name for make in (*profiles.BUILT_IN.values(), *PROTOCOLS.values())]
    names = [profile_name(name, KOREAN) for name in (*profile_names, *(SET_UP_min.keys() - {"press"}), "fast_ramps")]
    assert [name for name in names if english_in(name)] == []


def test_every_sentence_on_a_gap_is_korean(english_in: English) -> None:
    for code in GAP_SENTENCES:
        blank = {name: "" for name in re.findall(r"\{(\w+)", GAP_SENTENCES[code])}
        assert english_in(text("ko", f"reason.{code}", **blank)) == [], code


def test_every_departure_outside_the_catalogue_has_its_sentence() -> None:
    likes = [Reason(one.id) for one in (*UNMODELLED_EFFECTS, WARM_DIVIDER)]
    assert {one.code for one in likes} == {code for code in GAP_SENTENCES if code.startswith("gap.like.")}
