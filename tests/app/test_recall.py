"""Files that were given out and no longer hold are named, taken out of their folders, and their devices recalled."""

import json

import pytest

from softcal.app.cli.main import main
from softcal.app.export.manifest import read_manifest
from softcal.db.connection import open_registry
from tests.app.test_trim_command import drifted_V

pytestmark = pytest.mark.usefixtures("separate_data_folder")


def passed(url: str) -> list[str]:
    with open_registry(url) as registry:
        return [unit.serial for unit in registry.lots.units("small") if unit.verdict == "pass"]


@pytest.fixture
def given_out(calibrated, tmp_path):
    """URL of a registry whose released units went out, into a folder, and the folder."""
    out = tmp_path / "out"
    assert main(["export", "--lot", "small", "--registry", calibrated, "--format", "blob", "--out", str(out)]) == 0
    return calibrated, out


def recalled(url: str, tmp_path) -> list[dict[str, object]]:
    path = tmp_path / "recall.json"
    assert main(["registry", "recall", "--registry", url, "--json", str(path)]) == 0
    return json.loads(path.read_text())["units"]


def test_nothing_is_recalled_while_what_went_out_holds(given_out, tmp_path):
    url, out = given_out
    assert recalled(url, tmp_path) == []
    assert main(["export", "--lot", "small", "--registry", url, "--format", "blob", "--out", str(out)]) == 0
    with open_registry(url) as registry:
        assert len(registry.declarations.in_force("exports")) == len(passed(url))
        assert not registry.verify(is_quick=True)


def test_a_stricter_limit_names_the_files_takes_them_back_and_lists_the_devices(
    given_out, tmp_path, monkeypatch, capsys
):
    # In a pipe a row is one line: the folder stands in it as a whole, however long its name is.
    monkeypatch.delenv("COLUMNS", raising=False)
    url, out = given_out
    before, limit = (
        passed(url),
        ["lot", "limit", "small", "--rmse", "0.001", "--reason", "drawing C", "--registry", url],
    )
    capsys.readouterr()
    assert main(limit) == 2
    stdout = capsys.readouterr().out
    assert all(serial in stdout for serial in before) and str(out) in stdout
    assert all((out / f"unit-{serial}.ssc").exists() for serial in before), "an act that was not confirmed did it"
    assert main([*limit, "--yes"]) == 0
    assert not [serial for serial in before if (out / f"unit-{serial}.ssc").exists()]
    assert all(read_manifest(out).units[serial]["withdrawn"] for serial in before)
    units = recalled(url, tmp_path)
    assert {(one["lot"], one["serial"], one["revision"]) for one in units} == {("small", s, 1) for s in before}
    assert all(one["place"] == str(out) and one["verdict"] == "fail" and one["why"] for one in units)


def test_a_trim_recalls_its_own_unit_alone_until_new_files_go_out(given_out, tmp_path):
    url, out = given_out
    serial, others = "A1", [one for one in passed(url) if one != "A1"]
    assert serial in passed(url) and others
    (tmp_path / "loads.csv").write_text(f"output,reference\n{drifted_V(0.0)},0\n{drifted_V(2.5)},2.5\n")
    trim = ["trim", "--serial", serial, "--loads", str(tmp_path / "loads.csv"), "--registry", url, "--yes"]
    assert main(trim) == 0
    (one,) = recalled(url, tmp_path)
    assert (one["serial"], one["revision"]) == (serial, 1)
    assert not (out / f"unit-{serial}.ssc").exists() and all((out / f"unit-{s}.ssc").exists() for s in others)
    again = ["export", "--serial", serial, "--registry", url, "--format", "blob", "--failed-too", "--out", str(out)]
    assert main(again) == 0
    assert recalled(url, tmp_path) == []


def test_the_list_of_one_lot_needs_a_lot_that_is_known(given_out, capsys):
    assert main(["registry", "recall", "--lot", "none", "--registry", given_out[0]]) == 2
    assert "none" in capsys.readouterr().err
