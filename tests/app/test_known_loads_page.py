"""Known loads from their page and in the rules: what is refused and why, and that a calibration uses what was taken."""

import json
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.registry.known_loads import known_loads
from softcal.app.texts.catalogue import text
from softcal.core.errors import InputError
from softcal.core.quality.known_loads import KnownLoad
from softcal.core.quality.line_rules import LineRules
from softcal.db.connection import open_registry

pytestmark = pytest.mark.usefixtures("separate_data_folder")


translate = partial(text, "en")


def table_of(folder: Path) -> bytes:
    """Return loads of A1 that its own recording may have given, of A2 in another unit, of a unit against its source."""
    rows = []
    for serial, loads in (("A1", (0.0, 2.0)), ("A2", (0.0, 2000.0)), ("A3", (2.0, 0.0))):
        output = pd.read_csv(folder / "units" / f"{serial}.csv")["output"]
        ends = sorted((output.quantile(0.02), output.quantile(0.85)), key=lambda level: abs(level - output.iloc[0]))
        rows += [f"{serial},{level},{load}" for level, load in zip(ends, loads, strict=True)]
    return ("serial,output,reference\n" + "\n".join(rows)).encode()


@pytest.mark.long
def test_loads_are_looked_at_taken_and_used(calibrated, lot_folder, show, jobs_at_once):
    screen = show(calibrated, "lot", tab="known_loads", lot="small")
    assert not screen.exception and translate("known_loads.none") in [one.value for one in screen.caption]
    screen.file_uploader[0].set_value([("loads.csv", table_of(lot_folder), "text/csv")]).run()
    assert not screen.exception and not screen.error, [one.value for one in screen.error]
    why = {row.iloc[0]: row.iloc[-1] for _, row in screen.table[-1].value.iterrows()}
    assert set(why) == {"A2", "A3"} and why["A2"] != why["A3"]
    with open_registry(calibrated) as registry:
        assert not registry.calibrations.get("A1", lot_id="small").state.correspondence.is_anchored
    next(one for one in screen.button if one.key == "known-loads-take").click().run(timeout=300)
    assert not screen.exception and not screen.error, [one.value for one in screen.error]
    with open_registry(calibrated) as registry:
        calibration = registry.calibrations.get("A1", lot_id="small")
        (loads,) = known_loads(registry, "small").values()
        assert (
            calibration.state.correspondence.is_anchored
            and calibration.state.fit.recording_sha256 == loads.recording_sha256
        )
        assert (loads.serial, loads.actor, loads.where) == ("A1", "Erin", "page")
        assert not registry.calibrations.get("A2", lot_id="small").state.correspondence.is_anchored
    table = show(calibrated, "lot", tab="known_loads", lot="small").table[0].value
    assert list(table.iloc[0])[:2] == ["[A1](unit?unit=small%2FA1)", "0, 2"]


def test_who_may_only_audit_sees_them_and_brings_none(calibrated, show):
    screen = show(calibrated, "lot", tab="known_loads", role="quality", lot="small", lang="ko")
    assert not screen.exception and not screen.error and not screen.file_uploader


@pytest.mark.parametrize(
    ("load", "expanded", "is_taken"),
    [(2.0, 0.002, True), (2000.0, 0.0, False), (2.0, 1.0, False)],
    ids=["good", "in another unit", "not known well enough"],
)
def test_the_rules_take_loads_that_a_calibration_can_use(calibrated, show, load, expanded, is_taken):
    screen = show(calibrated, "lot", tab="limits", lot="small")
    for key, value in (("rules-load-1", 0.0), ("rules-load-2", load), ("rules-load-u-2", expanded)):
        screen.number_input(key=f"{key}-small-0").set_value(value)
    screen.text_input(key="reason-text-rules-small-0").set_value("two weights")
    button = next(one for one in screen.button if one.label == translate("rules.set"))
    button.click().run()
    assert not screen.exception
    with open_registry(calibrated) as registry:
        loads = registry.lots.line_rules(registry.lots.get("small")).loads
    assert bool(screen.error) != is_taken
    assert loads == ((KnownLoad(0.0), KnownLoad(load, expanded)) if is_taken else ())


@pytest.mark.parametrize("loads", [((-1.0, 0.0),), ((1.0, -1.0),), ((1.0, 0.0),) * 2, ((0.0,), (1.0,), (2.0,))])
def test_rules_with_loads_that_make_no_sense_are_refused(loads):
    with pytest.raises(InputError):
        LineRules(loads=loads)


@pytest.mark.parametrize("loads", [(), (KnownLoad(0.0), KnownLoad(2.0, 0.002))])
def test_rules_are_read_back_as_they_were_kept(loads: tuple[KnownLoad, ...]) -> None:
    rules = LineRules(loads=loads)
    settings = json.loads(json.dumps(rules.settings()))
    assert LineRules(**settings) == rules
