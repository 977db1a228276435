"""Every result says what made it, from what, when and by whom: one record, whatever its kind."""

import hashlib
import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import softcal
from softcal.app.bootstrap import current_user
from softcal.app.calibration.lot_decision import LotDecision
from softcal.app.cli.main import main
from softcal.app.views.next_step import release_record
from softcal.core import profiles
from softcal.core.gap.method import METHOD as GAP_METHOD
from softcal.core.lot import Lot
from softcal.core.quality.lot_status import LotStatus, UnitInLot
from softcal.db.connection import open_registry
from softcal.db.provenance import Provenance, build_id
from tests.app.pdf_text import read_text
from tests.app.test_gap_command import write_run
from tests.app.test_trim_command import drifted_V

pytestmark = pytest.mark.usefixtures("separate_data_folder")

PARTS = {"version", "build", "method", "inputs", "made_at", "actor"}


def run_as_json(folder: Path, *arguments: object) -> dict[str, Any]:
    """Return what a command writes as JSON."""
    out = folder / "answer.json"
    assert main([*map(str, arguments), "--json", str(out)]) in (0, 1)
    content: dict[str, Any] = json.loads(out.read_text())
    return content


def exported(url: str, folder: Path, kind: str) -> Path:
    out = folder / "files"
    arguments = ["export", "--serial", "A1", "--registry", url, "--format", kind, "--failed-too", "--out", str(out)]
    assert main(arguments) == 0
    return out


def revision(url: str, folder: Path) -> dict[str, Any]:
    return run_as_json(folder, "registry", "history", "--serial", "A1", "--registry", url)["revisions"][-1]


def statement(url: str, folder: Path) -> dict[str, Any]:
    return run_as_json(folder, "lot", "release", "small", "--registry", url)


def device_file(url: str, folder: Path) -> dict[str, Any]:
    return json.loads((exported(url, folder, "json") / "unit-A1.json").read_text())["calibration"]


def manifest(url: str, folder: Path) -> dict[str, Any]:
    return json.loads((exported(url, folder, "blob") / "manifest.json").read_text())["units"]["A1"]


@pytest.mark.parametrize("read", [revision, statement, device_file, manifest])
def test_a_result_of_the_registry_has_the_whole_record(
    calibrated: str, tmp_path: Path, read: Callable[[str, Path], dict[str, Any]]
) -> None:
    with open_registry(calibrated) as registry:
        state = registry.calibrations.get("A1").state
    provenance = read(calibrated, tmp_path)["provenance"]
    assert set(provenance) == PARTS
    assert (provenance["version"], provenance["build"]) == (softcal.__version__, build_id())
    assert provenance["method"] == state.fit.method.id and provenance["actor"] == current_user()
    assert state.fit.network_id in provenance["inputs"].values()
    assert all(len(sha256) == 64 for sha256 in provenance["inputs"].values())
    assert timedelta() < datetime.now(UTC) - datetime.fromisoformat(provenance["made_at"]) < timedelta(hours=3)
    if read is not statement:
        assert provenance["inputs"]["recording"] == state.fit.recording_sha256


@pytest.mark.parametrize(("kind", "name"), [("pdf", "certificate-A1.pdf"), ("dcc", "certificate-A1.xml")])
def test_a_certificate_prints_the_record(calibrated: str, tmp_path: Path, kind: str, name: str) -> None:
    file = exported(calibrated, tmp_path, kind) / name
    text = read_text(file.read_bytes()) if kind == "pdf" else file.read_text(encoding="utf-8")
    printed = "".join(text.split())
    provenance = revision(calibrated, tmp_path)["provenance"]
    for part in (
        provenance["build"],
        provenance["method"],
        provenance["actor"],
        provenance["made_at"],
        provenance["inputs"]["recording"],
    ):
        assert "".join(part.split()) in printed, part


def test_the_page_on_a_lot_prints_the_record(calibrated: str, tmp_path: Path) -> None:
    page = tmp_path / "lot.pdf"
    provenance = run_as_json(tmp_path, "lot", "release", "small", "--registry", calibrated, "--pdf", page)["provenance"]
    text = " ".join(read_text(page.read_bytes()).split())
    for part in (provenance["actor"], provenance["version"], provenance["build"][:8], provenance["method"][:8]):
        assert part in text, part


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    write_run(tmp_path / "rig", profiles.random_presses(np.random.default_rng(1), 20, 3))
    return tmp_path / "rig"


def test_a_gap_report_and_the_twin_of_it_have_the_whole_record(rig: Path, tmp_path: Path) -> None:
    report, twin = tmp_path / "rig.gap.json", tmp_path / "rig.twin.json"
    assert main(["gap", "diagnose", str(rig), "--json", str(report)]) == 0
    assert main(["gap", "apply", "--report", str(report), "--out", str(twin)]) == 0
    inputs_of = {
        report: {str(path.relative_to(rig)): path for path in rig.rglob("recording.*")},
        twin: {report.name: report},
    }
    for file, inputs in inputs_of.items():
        provenance = json.loads(file.read_text())["provenance"]
        assert set(provenance) == PARTS and provenance["method"] == GAP_METHOD.id
        assert (provenance["build"], provenance["actor"]) == (build_id(), current_user())
        assert provenance["inputs"] == {
            name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in inputs.items()
        }


def test_a_diagnosis_in_python_has_the_whole_record(rig: Path) -> None:
    provenance = softcal.diagnose(rig).report()["provenance"]
    assert set(provenance) == PARTS and provenance["method"] == GAP_METHOD.id
    assert provenance["inputs"] == {
        str(path.relative_to(rig)): hashlib.sha256(path.read_bytes()).hexdigest() for path in rig.rglob("recording.*")
    }


def test_whoever_fits_a_lot_after_its_release_did_not_release_it() -> None:
    provenance = Provenance(
        version="1", build="", method="m", inputs={}, made_at="2026-05-01T09:00:00+00:00", actor="kim"
    )
    decision = LotDecision(released=("A1",), provenance=provenance)
    with open_registry("sqlite://") as registry:
        registry.lots.add(Lot("L1", "S0", 50.0))
        registry.decisions.add("L1", msgspec.to_builtins(decision), action="release", actor="kim")
        registry.decisions.add("L1", msgspec.to_builtins(decision), action="fit", actor="lee")
        record = release_record(registry, LotStatus("L1", [UnitInLot("A1", "pass")], None, None))
    assert record is not None
    assert (record.actor, record.at) == ("kim", datetime(2026, 5, 1, 9, tzinfo=UTC))


def test_a_rollback_says_which_program_made_it_and_not_which_made_the_map(
    calibrated: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "loads.csv").write_text(f"output,reference\n{drifted_V(0.0)},0\n{drifted_V(2.5)},2.5\n")
    assert (
        main(["trim", "--serial", "A1", "--loads", str(tmp_path / "loads.csv"), "--registry", calibrated, "--yes"]) == 0
    )
    later = {"version": "9.9", "build": "f" * 40}
    monkeypatch.setattr("softcal.db.repositories.calibrations.software_now", lambda: later)
    arguments = ["--serial", "A1", "--to", "1", "--reason", "back", "--registry", calibrated, "--yes"]
    assert main(["registry", "rollback", *arguments]) == 0
    provenance = revision(calibrated, tmp_path)["provenance"]
    assert {name: provenance[name] for name in later} == later
