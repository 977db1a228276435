"""Another limit says what it changes before it does it: command and page, by the very decision that is then made."""

import json

import pytest

from softcal.app.calibration.changes import change_limit, preview_limit
from softcal.app.calibration.release import roll_back
from softcal.app.cli.main import main
from softcal.app.texts.catalogue import text
from softcal.db.connection import open_registry

STRICT_N = 0.01


def verdicts(registry) -> dict[str, str]:
    return {unit.serial: unit.verdict for unit in registry.lots.units("small") if unit.role == "target"}


def contents(registry) -> tuple[object, ...]:
    limits = registry.lots.limit_versions("small")
    return verdicts(registry), limits, registry.trail.rows(), registry.pages.change_marker("small")


@pytest.mark.parametrize("rmse", [None, 0.005, STRICT_N, 0.1, 0.13, 0.2, 5.0])
def test_what_is_shown_is_what_then_happens_and_showing_it_changes_nothing(calibrated, rmse):
    with open_registry(calibrated) as registry:
        before = contents(registry)
        changes = preview_limit(registry, "small", rmse)
        assert contents(registry) == before
        change_limit(registry, "small", rmse, reason="drawing D 117")
        after = verdicts(registry)
    changed = {serial for serial in after if after[serial] != before[0][serial]}  # type: ignore[index]
    assert {one.serial: one.next_verdict for one in changes.changed} == {serial: after[serial] for serial in changed}
    assert {one.serial for one in changes.withdrawn} == {s for s in changed if before[0][s] == "pass"}  # type: ignore[index]
    assert changes.counts == {word: [*after.values()].count(word) for word in changes.counts}


def test_a_rollback_to_a_revision_of_another_limit_is_held_against_the_one_in_force(calibrated):
    with open_registry(calibrated) as registry:
        change_limit(registry, "small", STRICT_N, reason="drawing D 117")
        strict = verdicts(registry)
        (first,) = [one for one in registry.calibrations.history("A1") if one.revision == 1]
        assert first.state.limit.maximum_rmse != STRICT_N
        roll_back(registry, "A1", 1, reason="the map of then", lot_id="small")
        now = registry.calibrations.get("A1").state
        assert verdicts(registry) == strict and now.limit.maximum_rmse == STRICT_N


def limit(url: str, *more: str) -> int:
    return main(["lot", "limit", "small", "--registry", url, *more])


def test_the_command_without_a_terminal_prints_and_changes_nothing(calibrated, capsys):
    with open_registry(calibrated) as registry:
        before = contents(registry)
    assert limit(calibrated, "--rmse", str(STRICT_N), "--reason", "drawing") == 2
    printed = capsys.readouterr()
    passed = sum(word == "pass" for word in before[0].values())  # type: ignore[attr-defined]
    assert passed and f"units withdrawn: {passed}," in printed.out and "--yes" in printed.err
    with open_registry(calibrated) as registry:
        assert contents(registry) == before
    assert limit(calibrated, "--rmse", str(STRICT_N), "--reason", "drawing", "--yes") == 0
    with open_registry(calibrated) as registry:
        assert "pass" not in verdicts(registry).values()
    assert limit(calibrated) == 0


@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 2), ("", 2)])
def test_at_a_terminal_it_asks(calibrated, capsys, monkeypatch, tmp_path, answer, code):
    import io

    terminal, file = io.StringIO(f"{answer}\n"), tmp_path / "limit.json"
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr("sys.stdin", terminal)
    assert limit(calibrated, "--rmse", str(STRICT_N), "--reason", "drawing", "--json", str(file)) == code
    content = json.loads(file.read_text())
    assert content["is_done"] == (code == 0) and content["changes"]["withdrawn"] > 0
    with open_registry(calibrated) as registry:
        assert ("pass" in verdicts(registry).values()) == (code != 0)


def test_the_page_says_how_many_units_its_button_withdraws(calibrated, show):
    with open_registry(calibrated) as registry:
        passed = sum(word == "pass" for word in verdicts(registry).values())
        expected = preview_limit(registry, "small", STRICT_N)
    screen = show(calibrated, "lot", tab="limits", lot="small")
    screen.number_input[0].set_value(STRICT_N).run()
    what = text("en", "limits.set", limit=f"{STRICT_N:g} N")
    label = text("en", "limits.set.withdrawing", what=what, count=passed)
    assert label in {button.label for button in screen.button}
    assert len(expected.withdrawn) == passed > 0
    page_text = " ".join(one.value for one in screen.markdown)
    assert f"{text('en', 'verdict.fail')} {expected.counts['fail']}" in page_text
    assert "stay as they are" not in page_text + " ".join(one.value for one in screen.caption)
