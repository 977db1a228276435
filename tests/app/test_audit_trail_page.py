"""The audit trail in words: every kind of row is a sentence, filters take what they say, and it is taken along."""

import ast
import json
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path

import pytest

from softcal.app.texts.catalogue import LANGUAGES, catalogue, text
from softcal.app.views.audit_trail import FIELDS, HEADINGS, SECTIONS, TrailFilter, entry_of, trail
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.quality.line_rules import LineRules
from softcal.db.connection import open_registry
from softcal.db.entries import AuditRow, CellCertificate, GoldenRun

TRANSLATE = partial(text, "en")
NOW = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)

RULES = LineRules(target=40, loads=(KnownLoad(0.0), KnownLoad(2.0, 0.002)))


def row(action: str, entity: str, key: object, after: object = None, before: object = None, **more: str) -> AuditRow:
    texts = [None if values is None else json.dumps(values) for values in (before, after)]
    audit_row = AuditRow("o", 1, NOW, "Kim", action, entity, json.dumps(key), *texts, "because", "0" * 64, "1" * 64)
    return replace(audit_row, **more)


@pytest.fixture
def busy(calibrated: str) -> str:
    """A registry in which everybody has done something."""
    with open_registry(calibrated) as registry:
        registry.lots.set_limit("small", 0.3, reason="customer drawing", actor="Quinn")
        registry.lots.set_limit("small", 0.25, reason="revision C of the drawing", actor="Quinn")
        registry.lots.set_line_rules(
            "small",
            RULES,
            reason="order 4711",
            actor="Erin",
        )
        registry.people.set("Lee", "engineer", "2580", actor="Quinn", reason="new colleague")
        cell = CellCertificate("LC-9", "K-1", "KRISS", date(2026, 1, 2), date(2027, 1, 2), 50.0, 1.0)
        registry.stations.add_certificate(cell, actor="Erin")
        registry.stations.add_golden_run(GoldenRun("line-1", "small", "G1", NOW, 0.3, "N", False, ("too large",), "Oh"))
        registry.trail.add("export", "units", ("A1",), {"revision": 1, "file": "unit-A1.pdf"}, actor="Erin")
        first = registry.calibrations.history("A1")[0].state
        registry.calibrations.refuse("small", "A2", "retest", ("again",), actor="Erin")
        another = replace(first, limit=replace(first.limit, maximum_rmse=2.0 * first.limit.maximum_rmse))
        registry.calibrations.put_state("small", another, "release", actor="Erin", reason="held against another limit")
        registry.calibrations.put_state("small", first, "line", actor="Erin", reason="looked at it")
        for action in ("release", "withhold"):
            registry.decisions.add("small", {"released": []}, action=action, actor="Erin")
    return calibrated


def read_events() -> set[tuple[str, str]]:
    """Read every `trail.add(action, entity, ...)` and `state(registry, entity, ..., action=)` of the application.

    What a page offers to take along is written down for it: it gives `exported = (entity, ...)`.
    """
    root = Path(__file__).parents[2]
    modules = {path: ast.parse(path.read_text("utf-8")) for path in sorted((root / "app").rglob("*.py"))}
    constants = {"softcal." + path.relative_to(root).with_suffix("").as_posix().replace("/", "."): _constants(module)
                 for path, module in modules.items()}  # fmt: skip
    events = set()
    for path, module in modules.items():
        imported = {
            name.name: constants[part.module][name.name]
            for part in ast.walk(module)
            if isinstance(part, ast.ImportFrom) and part.module in constants
            for name in part.names
            if name.name in constants[part.module]
        }
        texts_by_name = imported | _constants(module)
        for call in ast.walk(module):
            is_tuple = isinstance(call, ast.Assign) and isinstance(call.value, ast.Tuple)
            if is_tuple and ast.unparse(call.targets[0]) == "exported":
                events |= {("export", entity) for entity in _texts_of(call.value.elts[0], texts_by_name)}
            if path.name == "actions.py" or not isinstance(call, ast.Call):
                continue
            if ast.unparse(call.func).endswith("trail.add"):
                actions, entities = (_texts_of(part, texts_by_name) for part in call.args[:2])
            elif ast.unparse(call.func).endswith("declarations.declare"):
                keywords = {word.arg: word.value for word in call.keywords}
                actions = _texts_of(keywords.get("action", ast.Constant("declare")), texts_by_name)
                entities = _texts_of(call.args[0], texts_by_name)
            else:
                continue
            events |= {(action, entity) for action in actions for entity in entities}
    return events


def _constants(module: ast.Module) -> dict[str, list[str]]:
    """Return the texts that names of a module stand for: one, or the two of a choice."""
    constants = {}
    for node in (node for node in ast.walk(module) if isinstance(node, ast.Assign)):
        target, value = node.targets[0], node.value
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=False))
        else:
            pairs = [(target, value)]
        for name, part in pairs:
            if isinstance(name, ast.Name):
                choices = [part.body, part.orelse] if isinstance(part, ast.IfExp) else [part]
                if all(isinstance(one, ast.Constant) and isinstance(one.value, str) for one in choices):
                    constants[name.id] = [one.value for one in choices]
    return constants


def _texts_of(part: ast.expr, constants: dict[str, list[str]]) -> list[str]:
    if isinstance(part, ast.IfExp):
        return [*_texts_of(part.body, constants), *_texts_of(part.orelse, constants)]
    return [str(part.value)] if isinstance(part, ast.Constant) else constants[part.id]  # type: ignore[attr-defined]


def test_every_event_that_the_application_states_has_a_sentence() -> None:
    events = read_events()
    assert len(events) >= 12
    assert {("export", entity) for entity in ("audit_trail", "lots", "units")} <= events
    assert [pair for pair in sorted(events) if "trail.{}.{}".format(*pair) not in catalogue()["en"]] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_every_row_of_a_busy_registry_is_a_sentence_without_tables_and_hashes(busy: str, language: str) -> None:
    with open_registry(busy) as registry:
        rows = registry.trail.rows()
    entries = trail(rows, partial(text, language))
    assert {f"trail.{e.row.action}.{e.row.entity}" for e in entries} <= set(catalogue()["en"])
    sentences = " ".join(f"{e.action_text} {e.changes_text}" for e in entries)
    assert (
        "sha256" not in sentences and "_id" not in sentences and not any(len(word) >= 32 for word in sentences.split())
    )
    assert {e.section for e in entries} <= set(HEADINGS)


def test_a_change_says_what_was_before_and_after(busy: str) -> None:
    with open_registry(busy) as registry:
        entries = trail(registry.trail.newest(100), TRANSLATE)
    limit = next(e for e in entries if e.row.action == "set_limit")
    assert limit.action_text == TRANSLATE("trail.set_limit.limits", lot="small") and "0.3 → 0.25" in limit.changes_text
    rules = next(e for e in entries if e.row.action == "set_rules")
    assert TRANSLATE("trail.field.target") in rules.changes_text and "40" in rules.changes_text
    assert TRANSLATE("trail.field.loads") in rules.changes_text and "0, 2 ± 0.002" in rules.changes_text
    person = next(e for e in entries if e.row.action == "set_user")
    assert "Engineer" in person.changes_text


def test_a_row_that_nobody_foresaw_is_shown_and_not_lost() -> None:
    entry = entry_of(row("bake", "cakes", ["sponge"], {"eggs": 3}), TRANSLATE)
    assert "bake" in entry.action_text and "sponge" in entry.action_text and entry.section == "registry"


def test_a_limit_stands_in_the_trail_as_it_was_stated() -> None:
    entry = entry_of(row("set_limit", "limits", ["L1", 2], {"lot_id": "L1", "rmse": 0.12345}), TRANSLATE)
    assert [now for _, _, now in entry.changes] == ["0.12345"]


def test_the_filter_takes_what_it_says() -> None:
    rows = [
        row("set_limit", "limits", ["L1", 1], {"lot_id": "L1", "rmse": 0.2}),
        row("set_user", "users", ["Lee"], {"role": "engineer"}, actor="Quinn"),
        row("export", "units", ["A1"], {"file": "a.pdf"}, at=NOW - timedelta(days=3)),
    ]
    entries = trail(rows, TRANSLATE)

    def actions_taken(**query) -> list[str]:
        return [e.row.action for e in entries if TrailFilter(**query).takes(e)]

    assert actions_taken() == ["set_limit", "set_user", "export"]
    assert actions_taken(text="LIMIT l1") == ["set_limit"] and actions_taken(text="limit lee") == []
    assert actions_taken(actors=("Quinn",)) == ["set_user"]
    assert actions_taken(sections=("papers",)) == ["export"]
    assert actions_taken(since=NOW - timedelta(days=1)) == ["set_limit", "set_user"]
    assert actions_taken(until=NOW - timedelta(days=1)) == ["export"]


def test_every_field_and_heading_has_its_word() -> None:
    keys = {f"trail.field.{name}" for name in FIELDS} | {f"trail.section.{name}" for name in HEADINGS}
    assert keys <= set(catalogue()["en"])
    assert set(SECTIONS.values()) <= set(HEADINGS)


def test_the_page_is_searched_and_shows_the_row_itself_only_when_asked(busy: str, open_page) -> None:
    def page() -> None:
        from softcal.app.ui.tabs import settings

        settings.draw_audit_trail()

    screen = open_page(busy, page, role="quality")
    assert not screen.exception and not screen.error and not screen.code
    screen.text_input(key="trail-find").set_value("drawing revision").run()
    (table,) = [frame.value for frame in screen.dataframe]
    assert len(table) == 1 and "0.3 → 0.25" in str(table.iloc[0].tolist())
    screen.multiselect(key="trail-actor").set_value(["Erin"]).run()
    assert not screen.dataframe and screen.caption
