"""The desk's pages, drawn in process from a registry: what they say, when there is nothing, and in two languages."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from streamlit.testing.v1 import AppTest

from softcal.app import desk, texts
from softcal.app.cli import main
from softcal.app.views import lot_view
from softcal.db.connection import open_registry

MAIN = Path(desk.__file__).with_name("main.py")


@pytest.fixture(scope="module")
def calibrated(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A registry with the small lot calibrated, one unit of it dead."""
    root = tmp_path_factory.mktemp("screens")
    shutil.copytree(trained_lot / "lot", root / "lot")
    shutil.copy(trained_lot / "registry.db", root / "registry.db")
    dead = "t_s,output\n" + "".join(f"{k / 50},0.5\n" for k in range(1500))
    (root / "lot/units/A4.csv").write_text(dead)
    url = f"sqlite:///{root / 'registry.db'}"
    main(["batch", str(root / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"])
    return url


@pytest.fixture
def open_page(monkeypatch: pytest.MonkeyPatch):
    def show(url: str, page: Callable[[], None] | None = None, **query: str) -> AppTest:
        monkeypatch.setenv("SOFTCAL_REGISTRY", url)
        desk.registry.clear()
        screen = AppTest.from_file(str(MAIN)) if page is None else AppTest.from_function(page)
        for key, value in query.items():
            screen.query_params[key] = value
        screen.run(timeout=120)
        assert not screen.exception
        return screen

    return show


def test_every_text_stands_in_every_language() -> None:
    english = texts.catalogue()["en"]
    for language in texts.LANGUAGES:
        assert texts.catalogue()[language].keys() == english.keys()


def test_the_lot_shows_its_units_and_the_one_that_needs_a_look(calibrated: str, open_page) -> None:
    screen = open_page(calibrated)
    shown = {metric.label: metric.value for metric in screen.metric}
    assert shown["Units"] == "4 / 4"
    assert any("A4" in line.value and "constant" in line.value for line in screen.markdown)


def test_the_lot_counts_what_the_registry_holds(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        view = lot_view(registry, "small")
    assert sum(view.counts.values()) == 4
    assert view.needing_a_look[0].serial == "A4"


def test_an_empty_registry_says_how_to_begin(tmp_path: Path, open_page) -> None:
    screen = open_page(f"sqlite:///{tmp_path / 'new.db'}")
    assert "softcal batch" in screen.info[0].value


def _unit_page() -> None:
    from softcal.app.app_pages import unit

    unit.render()


def _audit_page() -> None:
    from softcal.app.app_pages import audit_trail

    audit_trail.render()


def test_a_unit_shows_its_verdict_its_reasons_and_its_history(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _unit_page, unit="A1")
    assert any("limit" in line.value for line in screen.markdown)
    assert screen.dataframe[0].value["Revision"].tolist() == [1]


def test_a_unit_without_a_map_says_why(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, _unit_page, unit="A4")
    assert "constant" in screen.info[0].value


def test_the_audit_trail_names_who_did_what(calibrated: str, open_page) -> None:
    actions = open_page(calibrated, _audit_page).dataframe[0].value["Action"]
    assert {"add", "calibrate", "refuse"} <= set(actions)


def test_the_screens_speak_korean(calibrated: str, open_page) -> None:
    screen = open_page(calibrated, lang="ko")
    assert "제품 수" in {metric.label for metric in screen.metric}
