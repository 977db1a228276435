"""`softcal station qualify` writes a page, and the gate of its station reads it."""

import json
from datetime import UTC, date, datetime, timedelta

import pytest

from softcal.app.cli.main import command_parser
from softcal.app.line.qualification import QualificationPage, store_qualification
from softcal.app.line.station_gate import RIG_ONLY, StationGate
from softcal.core.orders import OrderKind
from softcal.core.quality.gate import RigStatus
from softcal.db.connection import open_registry
from softcal.station.devices.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig
from softcal.station.tasks.qualify import Figure, Qualification

CONFIG = StationConfig(StageConfig("a"), ReadoutConfig("b"), ForceConfig("c", serial="K1"))


def opened(registry):
    return StationGate(registry, "line-1", CONFIG, RIG_ONLY)(OrderKind.UNIT, RigStatus(timedelta(hours=1), True))


def test_the_command_writes_figures_limits_and_how_long_they_hold_and_the_gate_reads_them(tmp_path):
    url, page, report = f"sqlite:///{tmp_path / 'r.db'}", tmp_path / "page.md", tmp_path / "page.json"
    arguments = [
        "station",
        "qualify",
        "--simulated",
        "--out",
        page,
        "--json",
        report,
        "--name",
        "line-1",
        "--registry",
        url,
    ]
    options = command_parser(["station"]).parse_args(list(map(str, arguments)))
    code = options.run(options)
    content = json.loads(report.read_text())
    assert code == (0 if content["is_passed"] else 1)
    assert date.fromisoformat(content["due_on"]) == datetime.now(UTC).date() + timedelta(days=90)
    text = page.read_text()
    assert all(figure["name"] in text for figure in content["figures"]) and content["due_on"] in text
    with open_registry(url) as registry:
        names = [condition.name.code for condition in opened(registry).conditions]
        assert "gate.name.qualification" in names and opened(registry).is_open == content["is_passed"]


@pytest.mark.parametrize("days", ["0", "-5", "367", "1000000000"])
def test_a_page_that_would_hold_for_no_day_or_for_ever_is_refused_before_any_motion(days):
    with pytest.raises(SystemExit) as end:
        command_parser(["station"]).parse_args(["station", "qualify", "--out", "page.md", "--valid-days", days])
    assert end.value.code == 2


def test_a_figure_that_was_not_measured_is_called_so_and_does_not_pass():
    figure = Figure("compliance of frame and unit, in series", float("nan"), "mm/N")
    page = QualificationPage("line-1", CONFIG, "spring", Qualification((figure,), None, 80.0), datetime.now(UTC), 90)
    assert page.rows[0][1:] == ("not measured", "mm/N", "", "NOT GOOD") and page.verdict == "NOT PASSED"


def test_the_newest_page_counts_until_its_day(tmp_path):
    good, bad = Figure("backlash", 0.01, "mm", 0.05), Figure("backlash", 0.1, "mm", 0.05)
    with open_registry(f"sqlite:///{tmp_path / 'r.db'}") as registry:
        assert opened(registry).is_open
        now = datetime.now(UTC)
        for figure, made_at, is_open in (
            (good, now - timedelta(days=100), False),
            (bad, now - timedelta(hours=2), False),
            (good, now - timedelta(hours=1), True),
        ):
            qualification = Qualification((figure,), None, 80.0)
            store_qualification(registry, QualificationPage("line-1", CONFIG, "spring", qualification, made_at, 90))
            assert opened(registry).is_open == is_open
