"""The desk's pages, drawn in process from a registry: what they say, when there is nothing, and in two languages."""

import ast
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from softcal.app.cli.main import main
from softcal.app.texts import catalogue as texts
from softcal.app.texts.reasons import render_reason
from softcal.app.views.lot import lot_view
from softcal.core.messages.reason import plain
from softcal.db.connection import open_registry

UI = Path(__file__).parents[2] / "app" / "ui"


def test_every_text_stands_in_every_language():
    english = texts.catalogue()["en"]
    for language in texts.LANGUAGES:
        assert texts.catalogue()[language].keys() == english.keys()


def test_the_lot_shows_its_units_and_the_one_that_needs_a_look(calibrated, show):
    screen = show(calibrated, "lot", role=None)
    assert "4 / 4" in {metric.value for metric in screen.metric}
    worst = show(calibrated, "lot", role=None, tab="units").dataframe[0].value.iloc[0].tolist()
    assert any(str(cell).endswith("#A4") for cell in worst)
    with open_registry(calibrated) as registry:
        assert sum(lot_view(registry, "small").counts.values()) == 4


def test_an_empty_registry_says_how_to_begin(tmp_path, show):
    screen = show(f"sqlite:///{tmp_path / 'new.db'}", "lot", role=None)
    assert screen.info and not screen.exception


def test_a_unit_shows_its_verdict_its_reasons_and_its_history(calibrated, show):
    screen = show(calibrated, "unit", role=None, unit="A1")
    history = show(calibrated, "unit", role=None, unit="A1", tab="history")
    with open_registry(calibrated) as registry:
        (unit,) = registry.lots.units("small", "A1")
    assert all(any(str(why) in line.value for line in screen.markdown) for why in unit.reasons)
    assert any(table.value["Revision"].tolist() == [1] for table in history.table if "Revision" in table.value)


def test_the_audit_trail_names_who_did_what(calibrated, show):
    text = show(calibrated, "settings", tab="audit_trail", role="quality").dataframe[0].value.to_string()
    assert all(name in text for name in ("small", "A1", "A4"))


@pytest.mark.parametrize("language", texts.LANGUAGES)
def test_a_unit_without_a_map_says_why_in_the_language_of_the_reader(calibrated, show, language):
    with open_registry(calibrated) as registry:
        (why,) = registry.lots.units("small", "A4")[0].reasons
    text = show(calibrated, "unit", role=None, unit="A4", lang=language).info[0].value
    assert render_reason(why, partial(texts.text, language)) in text
    lot = show(calibrated, "lot", role=None, lang=language)
    assert texts.text(language, "lot.yield") in {metric.label for metric in lot.metric}


def test_a_filter_that_leaves_fewer_pages_goes_back_to_the_first(calibrated, show):
    with open_registry(calibrated) as registry:
        for k in range(60):
            registry.calibrations.refuse("small", f"B{k:02d}", "retest", (plain("cable"),))
    screen = show(calibrated, "lot", role=None, tab="units")
    screen.session_state["units-page-small"] = 2
    screen.run()
    assert len(screen.dataframe[-1].value) == 64 - 50
    screen.text_input(key="units-find-small").set_value("a").run()
    assert screen.dataframe[-1].value["Serial"].tolist()[0].endswith("#A4") and not screen.exception


def test_a_unit_whose_stream_has_ended_stands_among_the_units_in_use(calibrated, small_calibrated, tmp_path, show):
    stream = small_calibrated.parent / "lot/units/A1.csv"
    command = ["adapt", "--registry", calibrated, "--serial", "A1", str(stream)]
    assert main([*command, "--out", str(tmp_path / "o.csv")]) == 0
    screen = show(calibrated, "unit", tab="history", role=None, unit="small/A1")
    assert not screen.error, screen.error[0].value
    assert any("A1" in line.value for line in screen.header) and screen.metric


def test_a_trained_network_is_a_draft_until_somebody_releases_it_with_a_reason(calibrated, show):
    with open_registry(calibrated) as registry:
        first = registry.networks.released("small").network
        other = replace(registry.networks.get(first.id), output_mean=0.61)
        trial = registry.networks.add("small", other, {"validation_rmse": 0.05}, {}, "b" * 64, actor="Erin")
    screen = show(calibrated, "lot", tab="networks", role="engineer")
    rows = screen.table[0].value.to_dict("records")
    states = [texts.text("en", key) for key in ("networks.state.draft", "networks.in_use")]
    assert [state in row.values() for state, row in zip(states, rows, strict=True)] == [True, True]
    screen.text_input(key=f"reason-text-release-{trial[:12]}-draft").set_value("half the error")
    next(button for button in screen.button if button.label == texts.text("en", "networks.release.do")).click().run()
    assert not screen.exception and screen.success
    with open_registry(calibrated) as registry:
        state = registry.networks.released("small")
        assert (state.network.id, state.actor, state.reason) == (trial, "Erin", "half the error")


def test_no_field_of_a_page_shows_words_of_streamlit():
    """A choice of several with nothing chosen shows Streamlit's English, unless it is told what to show."""
    silent = []
    for file in sorted(UI.rglob("*.py")):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "multiselect":
                if "placeholder" not in {word.arg for word in call.keywords}:
                    silent.append(f"{file.name}:{call.lineno}")
    assert silent == []
