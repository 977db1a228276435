"""`softcal gap challenge`, `ask` and `score` on disk."""

import json
import shutil
from functools import partial
from pathlib import Path
from threading import Thread

import pytest

from softcal.app.cli.main import command_parser
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.gap.challenge import (
    ask_rig,
    make_challenge,
    open_challenge,
    press_rig_lot,
    record_experiment,
    score_challenge,
)
from softcal.app.gap.sealed_file import Examiner, ask_examiner, default_key_path, read_sealed
from softcal.core.errors import InputError


@pytest.fixture
def challenge(tmp_path: Path) -> tuple[Path, Path]:
    make_challenge(tmp_path / "sealed", tmp_path / "labels.json", count=3, seed=2)
    return tmp_path / "sealed", tmp_path / "labels.json"


def run(*arguments: object) -> int:
    options = command_parser(["gap"]).parse_args(["gap", *map(str, arguments)])
    return int(options.run(options) or 0)


def write_reports(folder: Path, names: list[str], verdict: str = "no_gap") -> Path:
    folder.mkdir()
    shrink = {"predicted": 0.0, "low": 0.0, "high": 0.0}
    report = {"verdict": verdict, "causes": [], "ambiguous_with": [], "where": [], "shrink": shrink}
    for name in names:
        (folder / f"{name}.json").write_text(json.dumps(report))
    return folder


def test_cases_have_the_written_form_and_no_label(challenge: tuple[Path, Path]) -> None:
    folder, _ = challenge
    header = (folder / "case-001/runs/1/recording.csv").read_text().splitlines()[0]
    metadata = json.loads((folder / "case-001/runs/1/recording.json").read_text())
    assert header.startswith("t_s,")
    assert {"vref_V", "adc_bits", "r_series_ohm", "sample_rate_Hz", "serial", "profile"} <= set(metadata)
    published = (folder / "challenge.json").read_text()
    assert "cause" not in published and "line" not in published


def test_the_commitment_is_printed_before_anything_is_diagnosed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("challenge", "--cases", 1, "--out", tmp_path / "sealed") == 0
    commitment = json.loads((tmp_path / "sealed/challenge.json").read_text())["commitment"]
    assert commitment in capsys.readouterr().out
    assert (tmp_path / "sealed.seal.json").exists() and (tmp_path / "sealed.seal.key").stat().st_mode & 0o77 == 0


def test_a_challenge_without_a_seed_takes_one_of_128_bits(tmp_path: Path) -> None:
    first, second = (make_challenge(tmp_path / name, tmp_path / f"{name}.json", 1) for name in "ab")
    seeds = [json.loads(read_sealed(tmp_path / f"{name}.json", tmp_path / f"{name}.key"))["seed"] for name in "ab"]
    assert min(seed.bit_length() for seed in seeds) > 96 and seeds[0] != seeds[1]
    assert first.commitment != second.commitment


def test_scores_are_written_and_their_check_fails_on_silence(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    reports = write_reports(folder.parent / "reports", ["case-001", "case-002", "case-003"], "unknown")
    arguments, scores = ("score", folder, "--reports", reports, "--seal", seal), folder.parent / "score.json"
    assert run(*arguments, "--json", scores) == 0
    assert len(json.loads(scores.read_text())["cases"]) == 3
    assert run(*arguments, "--check") == 1


def test_labels_cannot_be_read_without_the_key(challenge: tuple[Path, Path], tmp_path: Path) -> None:
    folder, seal = challenge
    effects = {cause.effect for label in open_challenge(folder, seal) for cause in label.case.causes}
    for path in (seal, *folder.rglob("*.*")):
        assert effects and not any(effect in path.read_text() for effect in effects)
    key = default_key_path(seal)
    assert not key.is_relative_to(folder)
    moved = key.rename(tmp_path / "examiner.key")
    with pytest.raises(InputError, match="cannot be read"):
        open_challenge(folder, seal)
    assert len(open_challenge(folder, seal, moved)) == 3
    make_challenge(tmp_path / "other", tmp_path / "other.json", 1)
    with pytest.raises(InputError, match="is not the key"):
        open_challenge(folder, seal, tmp_path / "other.key")


def test_a_changed_label_breaks_the_seal(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    sealed = json.loads(seal.read_text())
    at = len(sealed["labels"]) // 2
    other = "A" if sealed["labels"][at] != "A" else "B"
    seal.write_text(json.dumps(sealed | {"labels": sealed["labels"][:at] + other + sealed["labels"][at + 1 :]}))
    with pytest.raises(InputError, match="the seal is broken"):
        open_challenge(folder, seal)


def test_labels_made_afterwards_are_noticed_by_the_published_commitment(
    challenge: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, seal = challenge
    published = json.loads((folder / "challenge.json").read_text())["commitment"]
    assert len(open_challenge(folder, seal, commitment=published)) == 3
    # Another challenge, whose folder agrees with itself.
    make_challenge(tmp_path / "new", tmp_path / "new.json", count=3, seed=3)
    assert len(open_challenge(tmp_path / "new", tmp_path / "new.json")) == 3
    with pytest.raises(InputError, match="the seal is broken"):
        open_challenge(tmp_path / "new", tmp_path / "new.json", commitment=published)


def test_an_examiner_answers_where_the_examinee_has_neither_seal_nor_key(
    challenge: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, seal = challenge
    handed = tmp_path / "handed"
    shutil.copytree(folder, handed)
    with Examiner(partial(record_experiment, folder, seal)) as examiner:
        Thread(target=examiner.serve_forever, daemon=True).start()
        assert run("ask", handed, "case-001", "--experiment", "rate_sweep", "--examiner", examiner.address) == 0
        plan_path = Path(capsys.readouterr().out.strip())
        with pytest.raises(InputError, match="rate_sweep"):
            ask_examiner(examiner.address, "case-001", "dance", 1)
        with pytest.raises(InputError, match="does not know"):
            ask_examiner(f"{examiner.address}x", "case-001", "rest", 1)
        examiner.shutdown()
    mine = ask_rig(folder, partial(record_experiment, folder, seal), "case-001", "rate_sweep")
    for name in ("recording.csv", "recording.json"):
        assert (plan_path / name).read_bytes() == (mine / name).read_bytes()
    with pytest.raises(InputError, match="no answer"):
        ask_examiner("127.0.0.1:1:x", "case-001", "rest", 1)


def test_a_sheet_says_by_what_it_was_scored(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    published = json.loads((folder / "challenge.json").read_text())["commitment"]
    reports = write_reports(folder.parent / "reports", ["case-001"])
    sheet = score_challenge(folder, reports, seal, commitment=published).to_json()
    assert (sheet["commitment"], sheet["commitment_from"]) == (published, "stated")
    assert sheet["seed_origin"] == "stated"
    assert list(sheet["provenance"]["inputs"]) == ["case-001.json"] and sheet["provenance"]["version"]
    assert score_challenge(folder, reports, seal).to_json()["commitment_from"] == "folder"


def test_a_changed_recording_is_noticed(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    recording = folder / "case-002/runs/1/recording.csv"
    recording.write_text(recording.read_text() + "99,0,0,0\n")
    with pytest.raises(InputError, match="case-002"):
        open_challenge(folder, seal)


def test_an_experiment_is_added_and_the_case_stays_sealed(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    answered_case = ask_rig(folder, partial(record_experiment, folder, seal), "case-001", "rate_sweep")
    again = ask_rig(folder, partial(record_experiment, folder, seal), "case-001", "dummy_resistor")
    assert answered_case.name == "asked-1" and again.name == "asked-2"
    assert json.loads((again / "recording.json").read_text())["dummy_ohm"] > 0
    assert len(open_challenge(folder, seal)) == 3


@pytest.mark.parametrize(("seal", "count"), [("seal.json", 0), ("seal.json", -3), ("sealed/seal.json", 1)])
def test_no_case_and_a_seal_beside_the_cases_are_refused(tmp_path: Path, seal: str, count: int) -> None:
    with pytest.raises(InputError):
        make_challenge(tmp_path / "sealed", tmp_path / seal, count)
    assert not (tmp_path / "sealed").exists()


def test_a_used_folder_and_a_used_seal_are_refused(challenge: tuple[Path, Path], tmp_path: Path) -> None:
    folder, seal = challenge
    original = seal.read_bytes()
    with pytest.raises(InputError):
        make_challenge(folder, tmp_path / "other.json", 1)
    with pytest.raises(InputError):
        make_challenge(tmp_path / "new", seal, 1)
    assert seal.read_bytes() == original and len(open_challenge(folder, seal)) == 3


def test_a_challenge_that_was_cut_off_leaves_nothing_and_can_be_made_again(tmp_path: Path) -> None:
    def cut(name: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_challenge(tmp_path / "cases", tmp_path / "seal.json", 2, 4, on_case=cut)
    assert list(tmp_path.iterdir()) == []
    assert len(make_challenge(tmp_path / "cases", tmp_path / "seal.json", 2, 4).cases) == 2
    assert (tmp_path / "cases" / "challenge.json").is_file()


def test_reports_that_are_not_there_are_named(challenge: tuple[Path, Path]) -> None:
    folder, seal = challenge
    with pytest.raises(InputError, match="case-001.json"):
        score_challenge(folder, folder.parent / "nowhere", seal)


def test_unknown_names_are_answered_with_the_known_ones(challenge: tuple[Path, Path], tmp_path: Path) -> None:
    folder, seal = challenge
    with pytest.raises(InputError, match="rate_sweep"):
        ask_rig(folder, partial(record_experiment, folder, seal), "case-001", "dance")
    with pytest.raises(InputError, match="case-003"):
        ask_rig(folder, partial(record_experiment, folder, seal), "case-9", "rest")
    with pytest.raises(InputError, match="usual"):
        make_challenge(tmp_path / "x", tmp_path / "x.json", 1, line="odd")


def test_a_lot_pressed_on_a_sealed_rig_is_a_lot_folder_with_audits(
    challenge: tuple[Path, Path], tmp_path: Path
) -> None:
    folder, seal = challenge
    assert run("ask", folder, "case-001", "--lot", tmp_path / "lot", "--units", 2, "--seal", seal) == 0
    lot = open_lot_folder(tmp_path / "lot")
    assert sorted(lot.unit_paths) == sorted(lot.audit_paths) == ["R01", "R02"]
    audit = lot.read_audit("R01")
    assert audit is not None and audit.unlabelled.stage_mm is not None
    assert lot.read_source().unlabelled.t_s[-1] > 100.0


def test_a_lot_needs_a_unit(challenge: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError):
        press_rig_lot(*challenge, "case-001", 0, tmp_path / "lot")
