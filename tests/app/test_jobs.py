"""Jobs of the screens: done in a process of their own, they leave a result or one line that says why not."""

from datetime import UTC, datetime
from functools import partial

import numpy as np
import pytest

from softcal.app.gap.page_cases import cases, has_sealed_rig, practise, run_views_of, store_upload, truth
from softcal.app.jobs import launch as job_launch
from softcal.app.jobs.jobs import run_job
from softcal.app.texts.catalogue import text
from softcal.app.views.gap import cause_names, cause_rows, hidden_effects, location_rows, next_experiment
from softcal.app.views.network import hidden_widths, loss_spec
from softcal.core.errors import InputError
from softcal.core.messages.reason import to_line, unpack_reasons
from softcal.core.orders import RunState
from softcal.db.connection import open_registry
from tests.wait import wait_until

ENGLISH = partial(text, "en")
METADATA = {"vref_V": 5.0, "adc_bits": 16, "r_series_ohm": 1000.0, "sample_rate_Hz": 50.0, "serial": "A17"}


pytestmark = pytest.mark.usefixtures("separate_data_folder")


def run_csv(samples: int = 400) -> bytes:
    t_s = np.arange(samples) / 50.0
    stage_mm = 1.5 * (1 - np.cos(0.8 * t_s))
    rows = [f"{t:.3f},{s:.5f},{0.4 * s**1.3:.5f},{2.0 + 0.1 * s:.5f}" for t, s in zip(t_s, stage_mm, strict=True)]
    return "\n".join(["t_s,stage_mm,force_N,output_V", *rows]).encode()


def test_a_job_runs_in_a_process_of_its_own_and_its_result_is_registered(
    calibrated: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOFTCAL_REGISTRY", calibrated)
    request = {"lot": "small", "hidden": [6], "seed": 1, "members": 1, "max_epochs": 5}
    with open_registry(calibrated) as registry:
        board = registry.job_board
        job_id = job_launch.start_job(registry, "train", request, "Erin")
        wait_until(lambda: not board.job(job_id).state.is_active)
        job = board.job(job_id)
        assert (job.state, job.message[:5]) == (RunState.DONE, job.result["network"][:5])
        assert registry.networks.get(job.result["network"]).sizes[1] == 6
        assert len(job.result["trace"]["validation"]) == 5


def test_a_job_that_cannot_be_done_ends_with_one_line(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        for kind, request, message in (
            ("train", {"lot": "nowhere", "hidden": [4], "seed": 0, "members": 1, "max_epochs": 5}, "'nowhere'"),
            ("diagnose", {"case": "/nowhere"}, "/nowhere"),
            ("bake", {}, "bake"),
        ):
            job_id = registry.job_board.place(kind, request, "Erin")
            assert run_job(registry, job_id, lambda: None) is RunState.ERROR
            assert message in to_line(unpack_reasons(registry.job_board.job(job_id).message))


def test_a_defect_in_a_job_is_logged_and_reported(calibrated: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("softcal.app.jobs.jobs.check", broken)
    with open_registry(calibrated) as registry:
        job_id = registry.job_board.place("station_check", {}, "Erin")
        assert run_job(registry, job_id, lambda: None) is RunState.ERROR
        assert "ZeroDivisionError: oops" in registry.job_board.job(job_id).message


def test_a_job_somebody_wants_stopped_ends_cancelled(calibrated: str, monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []

    def endless(registry, job, report):
        registry.job_board.cancel(job.job_id)
        wait_until(lambda: messages)
        raise InputError("the process would be gone by now")

    monkeypatch.setattr("softcal.app.jobs.jobs.check", endless)
    monkeypatch.setattr("softcal.app.jobs.jobs.HEARTBEAT_S", 0.05)
    with open_registry(calibrated) as registry:
        job_id = registry.job_board.place("station_check", {}, "Erin")
        assert run_job(registry, job_id, lambda: messages.append("gone")) is RunState.CANCELLED


def test_an_upload_becomes_a_case_of_numbered_runs() -> None:
    case = store_upload("rig 7", [run_csv(), run_csv()], METADATA)
    assert sorted(path.parent.name for path in case.rglob("recording.csv")) == ["1", "2"]
    assert cases() == [case] and not has_sealed_rig(case)


@pytest.mark.parametrize("name", ["../rig", "", "a/b", ".hidden", "x" * 80])
def test_the_name_of_an_upload_is_no_path(name: str) -> None:
    with pytest.raises(InputError):
        store_upload(name, [run_csv()], METADATA)
    assert cases() == []


def test_an_upload_that_is_no_case_is_not_kept() -> None:
    with pytest.raises(InputError, match=" 30"):
        store_upload("rig", [run_csv(5)], METADATA)
    assert cases() == []


@pytest.mark.long
def test_a_practice_rig_is_pressed_once_more_and_diagnosed_and_its_figures_come_back(calibrated: str) -> None:
    case = practise("usual")
    assert has_sealed_rig(case) and cases() == [case] and len(truth(case)[0]) == 1
    with open_registry(calibrated) as registry:
        request = {"case": str(case), "experiment": "rate_sweep"}
        job_id = registry.job_board.place("diagnose", request, "Erin")
        assert run_job(registry, job_id, lambda: None) is RunState.DONE
        job = registry.job_board.job(job_id)
        runs = run_views_of(job.result, registry.job_board.arrays(job))
    assert [run.name for run in runs] == [run["name"] for run in job.result["runs"]]
    assert "asked-1" in {run.name for run in runs}
    for run in runs:
        for channel in run.channels.values():
            assert channel.measured.shape == channel.base.shape == channel.explained.shape == run.t_s.shape
            assert channel.noise > 0


ALPHA = {"alpha": {"value": 0.001, "low": 0.0009, "high": 0.0011, "unit": "1/K"}}
REPORT = {
    "where": [
        {"stage": "load_cell", "channel": "force", "regime": "rest", "share": 0.1, "detail": ""},
        {"stage": "transduction", "channel": "output", "regime": "hold", "share": 0.9, "detail": "slow"},
    ],
    "causes": [
        {"effect": "backlash", "stage": "motion", "probability": 0.01, "shrink": 0.0, "parameters": {}},
        {"effect": "thermal_drift", "stage": "transduction", "probability": 0.97, "shrink": 0.9, "parameters": ALPHA},
    ],
    "hidden_fraction": {"thermal_drift": 0.9, "backlash": 0.1, "creep": None},
    "ambiguous_with": [],
    "next_experiment": {"profile": "none", "why": ""},
}


def test_a_report_is_read_in_words_with_its_intervals() -> None:
    assert cause_names(REPORT, ENGLISH) == ["thermal drift (97.0 %)"]
    (cause,) = cause_rows(REPORT, ENGLISH)
    assert cause["values"] == "alpha = 0.001 (0.0009 to 0.0011) 1/K"
    assert [row["stage"] for row in location_rows(REPORT, ENGLISH)] == [
        ENGLISH(f"gap.stage.{stage}") for stage in ("transduction", "load_cell")
    ]
    assert hidden_effects(REPORT, ENGLISH) == ["thermal drift (90.0 %)"] and next_experiment(REPORT) is None


@pytest.mark.parametrize(("text", "widths"), [("120-70-35", [120, 70, 35]), ("8", [8]), ("16, 8", [16, 8])])
def test_layers_are_read_as_people_write_them(text: str, widths: list[int]) -> None:
    assert hidden_widths(text) == widths


@pytest.mark.parametrize("text", ["", "0", "12-x", "600", "1-1-1-1-1-1-1", "-"])
def test_other_layers_are_refused(text: str) -> None:
    with pytest.raises(InputError):
        hidden_widths(text)


def test_the_live_curve_has_units_on_its_axes() -> None:
    names = {"epoch": "epoch", "train": "training", "validation": "validation"}
    spec = loss_spec({"epoch": [1, 2], "train": [0.3, 0.2], "validation": [0.4, 0.3]}, "N", names)
    assert spec["yAxis"]["name"] == "RMSE [N]"
    assert spec["series"][1]["data"] == [(1, 0.4), (2, 0.3)]


def test_a_lost_job_is_distinguished_from_a_slow_one(calibrated: str) -> None:
    with open_registry(calibrated) as registry:
        job = registry.job_board.job(registry.job_board.place("train", {}, "Erin"))
    assert not job.is_lost(datetime.now(UTC))
