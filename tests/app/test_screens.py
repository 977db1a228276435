"""The desk's pages, drawn in process from a registry: what they say, when there is nothing, and in two languages."""

import ast
from dataclasses import replace
from pathlib import Path

from softcal.app.cli.main import main
from softcal.app.texts import catalogue as texts
from softcal.app.views.lot import lot_view
from softcal.core.words.reason import plain
from softcal.db.connection import open_registry

UI = Path(__file__).parents[2] / "app" / "ui"


def _lot_page() -> None:
    from softcal.app.ui.app_pages import lot

    lot.render()


def test_every_text_stands_in_every_language() -> None:
    english = texts.catalogue()["en"]
    for language in texts.LANGUAGES:
        assert texts.catalogue()[language].keys() == english.keys()


def test_the_lot_shows_its_units_and_the_one_that_needs_a_look(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _lot_page)
    shown = {metric.label: metric.value for metric in screen.metric}
    assert shown["Units"] == "4 / 4"
    worst = screen.dataframe[0].value.iloc[0]
    assert worst["Serial"] == "A4" and "constant" in worst["Why"]


def test_the_lot_counts_what_the_registry_holds(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
    assert sum(view.counts.values()) == 4
    assert view.looks[0].serial == "A4" and view.needing_a_look == sum(view.counts.values()) - view.counts["pass"]


def test_an_empty_registry_says_how_to_begin(tmp_path: Path, open_page) -> None:
    screen = open_page(f"sqlite:///{tmp_path / 'new.db'}", _lot_page)
    assert "Start" in screen.info[0].value


def _unit_page() -> None:
    from softcal.app.ui.app_pages import unit

    unit.render()


def _audit_page() -> None:
    from softcal.app.ui.app_pages import audit_trail

    audit_trail.render()


def test_a_unit_shows_its_verdict_its_reasons_and_its_history(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _unit_page, unit="A1")
    assert any("limit" in line.value for line in screen.markdown)
    assert any(table.value["Revision"].tolist() == [1] for table in screen.table if "Revision" in table.value)


def test_a_unit_without_a_map_says_why(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _unit_page, unit="A4")
    assert "constant" in screen.info[0].value


def test_the_audit_trail_names_who_did_what(calibrated: str, open_page) -> None:
    said = set(open_page(calibrated, _audit_page).dataframe[0].value["What"])
    assert {"Lot small was registered", "A1 was calibrated", "A4 was refused"} <= said


def test_the_screens_speak_korean(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _lot_page, lang="ko")
    assert "제품 수" in {metric.label for metric in screen.metric}


def test_reasons_are_said_in_korean(calibrated: str, open_page) -> None:
    unit = open_page(calibrated, _unit_page, unit="A1", lang="ko")
    assert any("예측 RMSE" in line.value and "한계" in line.value for line in unit.markdown)
    assert "죽은 채널" in open_page(calibrated, _unit_page, unit="A4", lang="ko").info[0].value
    lot = open_page(calibrated, _lot_page, lang="ko")
    assert "죽은 채널" in lot.dataframe[-1].value["이유"][0]


def test_a_filter_that_leaves_fewer_pages_goes_back_to_the_first(calibrated: str, open_page) -> None:
    with open_registry(calibrated) as registry:
        for k in range(60):
            registry.add_refusal("small", f"B{k:02d}", "retest", (plain("cable"),))
    screen = open_page(calibrated, _lot_page)
    screen.session_state["units-page-small"] = 2
    screen.run()
    assert len(screen.dataframe[-1].value) == 64 - 50
    screen.text_input(key="units-find-small").set_value("a").run()
    assert screen.dataframe[-1].value["Serial"].tolist()[0] == "A4" and not screen.exception


def _long_term_page() -> None:
    from softcal.app.ui.app_pages import long_term

    long_term.render()


def test_a_unit_whose_stream_has_ended_stands_among_the_units_in_use(
    calibrated: str, small_calibrated: Path, tmp_path: Path, open_page
) -> None:
    stream = small_calibrated.parent / "lot/units/A1.csv"
    assert (
        main(["adapt", "--registry", calibrated, "--serial", "A1", str(stream), "--out", str(tmp_path / "o.csv")]) == 0
    )
    screen = open_page(calibrated, _long_term_page)
    assert not screen.error, screen.error[0].value
    assert any("A1" in table.value.to_string() for table in [*screen.dataframe, *screen.table])


def _networks_page() -> None:
    from softcal.app.ui.app_pages import networks

    networks.render()


def test_a_trained_network_is_a_draft_until_somebody_releases_it_with_a_reason(calibrated: str, open_page) -> None:
    with open_registry(calibrated) as registry:
        first = registry.released_network("small").network
        other = replace(registry.network(first.id), output_mean=0.61)
        trial = registry.add_network("small", other, {"validation_rmse": 0.05}, {}, "b" * 64, actor="Erin")
    screen = open_page(calibrated, _networks_page, role="engineer")
    states = screen.table[0].value["State"].tolist()
    assert states == ["draft", "in use at the line"]
    screen.text_input(key=f"reason-text-release-{trial[:12]}-draft").set_value("half the error")
    next(button for button in screen.button if button.label == "Release to the line").click().run()
    assert not screen.exception and "uses" in screen.success[0].value
    with open_registry(calibrated) as registry:
        state = registry.released_network("small")
        assert (state.network.id, state.actor, state.reason) == (trial, "Erin", "half the error")


def test_no_field_of_a_page_shows_words_of_streamlit() -> None:
    """A choice of several with nothing chosen shows Streamlit's English, unless it is told what to show."""
    silent = []
    for file in sorted(UI.rglob("*.py")):
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "multiselect":
                if "placeholder" not in {word.arg for word in call.keywords}:
                    silent.append(f"{file.name}:{call.lineno}")
    assert silent == []
