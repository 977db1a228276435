"""`softcal adapt` on files: columns, the registry's course, resuming, the paper's queues, and inputs that are none."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.operation.adapt import AdaptOptions, adapt_file
from softcal.core.lot import UnitKey
from softcal.core.operation.adapter import AdaptConfig
from softcal.core.operation.method import DriftTracking
from softcal.db.connection import open_registry
from tests.layers import layered

A1 = UnitKey("small", "A1")
NETWORK = ("--hidden", "16,8")
QUEUES, QUEUE = ("ot", "ot-improved"), 200


@pytest.fixture(scope="module")
def bench(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a lot of one unit and a registry in which it is calibrated."""
    folder = tmp_path_factory.mktemp("adapt") / "small"
    shutil.copytree(trained_lot, folder)
    shutil.rmtree(folder / "lot/audit")
    for serial in ("A2", "A3"):
        (folder / f"lot/units/{serial}.csv").unlink()
    assert main(["batch", str(folder / "lot"), "--registry", url(folder), *NETWORK]) in (0, 1)
    return folder


def url(folder: Path) -> str:
    return f"sqlite:///{folder / 'registry.db'}"


def adapt(folder: Path, source: Path, target: Path, *more: str, serial: str = "A1") -> int:
    return main(["adapt", "--registry", url(folder), "--serial", serial, str(source), "--out", str(target), *more])


@pytest.fixture
def stream(bench: Path) -> Path:
    return bench / "lot/units/A1.csv"


@pytest.fixture(scope="module")
def whole(bench: Path) -> Path:
    """What the command writes for the unit's recording."""
    assert adapt(bench, bench / "lot/units/A1.csv", bench / "whole.csv") == 0
    return bench / "whole.csv"


def test_one_row_for_each_row_of_the_stream(stream: Path, whole: Path) -> None:
    rows, stream_rows = pd.read_csv(whole), pd.read_csv(stream)
    assert list(rows.columns) == ["t_s", "estimate", "lower", "upper", "flag"]
    np.testing.assert_allclose(rows["t_s"], stream_rows["t_s"])
    estimated = rows.dropna(subset=["estimate"])
    assert len(estimated) == len(stream_rows) - 14
    assert ((estimated["lower"] <= estimated["estimate"]) & (estimated["estimate"] <= estimated["upper"])).all()
    assert set(rows["flag"].str.split("; ").str[-1]) <= {"unwatched", "held", "followed"}


def test_a_shorter_file_has_the_same_first_rows(bench: Path, stream: Path, whole: Path, tmp_path: Path) -> None:
    pd.read_csv(stream).head(700).to_csv(tmp_path / "half.csv", index=False)

    adapt(bench, tmp_path / "half.csv", tmp_path / "out.csv")

    assert (tmp_path / "out.csv").read_text().splitlines() == whole.read_text().splitlines()[:701]


def test_a_reference_in_the_stream_is_never_read(bench: Path, stream: Path, whole: Path, tmp_path: Path) -> None:
    pd.read_csv(stream).assign(reference="not a number").to_csv(tmp_path / "with.csv", index=False)

    assert adapt(bench, tmp_path / "with.csv", tmp_path / "out.csv") == 0

    assert (tmp_path / "out.csv").read_bytes() == whole.read_bytes()


def test_parquet_goes_in_and_out(bench: Path, stream: Path, whole: Path, tmp_path: Path) -> None:
    pd.read_csv(stream).to_parquet(tmp_path / "in.parquet")

    assert adapt(bench, tmp_path / "in.parquet", tmp_path / "out.parquet") == 0

    first, second = pd.read_parquet(tmp_path / "out.parquet"), pd.read_csv(whole)
    np.testing.assert_allclose(first["estimate"], second["estimate"])


def test_missing_values_and_a_line_cut_off_are_rows_with_a_flag(bench: Path, stream: Path, tmp_path: Path) -> None:
    lines = stream.read_text().splitlines()
    lines[100] = lines[100].split(",")[0] + ","
    lines[200] = lines[200].split(",")[0] + ",nan"
    lines[300] = lines[299]
    cut = "\n".join(lines)[:-12]
    (tmp_path / "in.csv").write_text(cut + "1e")

    assert adapt(bench, tmp_path / "in.csv", tmp_path / "out.csv") == 0

    flags = pd.read_csv(tmp_path / "out.csv")["flag"].str.split("; ").str[0]
    assert len(flags) == len(lines) - 1
    assert flags[[99, 199, 299, len(flags) - 1]].tolist() == ["invalid"] * 4


def test_source_of_the_lot_has_the_identity_as_its_map(bench: Path, tmp_path: Path) -> None:
    source = bench / "lot/source/A0.csv"

    assert adapt(bench, source, tmp_path / "out.csv", serial="A0") == 0

    estimate, reference = pd.read_csv(tmp_path / "out.csv")["estimate"], pd.read_csv(source)["reference"]
    assert np.sqrt(np.nanmean((estimate - reference) ** 2)) < 0.3
    with open_registry(url(bench)) as registry:
        assert registry.calibrations.get("A0").state.fit.family == "identity"


def test_registry_keeps_every_map_once_however_often_a_file_is_run(bench: Path, stream: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    adapt(bench, stream, tmp_path / "first.csv", "--json", str(report))
    name = json.loads(report.read_text())["stream"]
    with open_registry(url(bench)) as registry:
        first = registry.adaptations.all(A1, name)

    adapt(bench, stream, tmp_path / "second.csv")

    with open_registry(url(bench)) as registry:
        assert registry.adaptations.all(A1, name) == first
        assert registry.verify() == []
    assert first[0]["event"] == "start"
    assert first[-1]["event"] == "checkpoint"


def test_next_file_goes_on_where_the_last_one_ended(bench: Path, stream: Path, tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        more = ("--stream", "hall-3", "--resume", "--json", str(tmp_path / f"{name}.json"))
        assert adapt(bench, stream, tmp_path / f"{name}.csv", *more) == 0

    with open_registry(url(bench)) as registry:
        adaptation = registry.adaptations.last(A1, 1, "hall-3")
    assert adaptation is not None
    assert adaptation["sample"] >= 2 * len(pd.read_csv(stream))
    assert (tmp_path / "monday.csv").read_text().count("\n") == (tmp_path / "tuesday.csv").read_text().count("\n")


def test_another_stream_under_the_same_name_is_refused(bench: Path, stream: Path, tmp_path: Path) -> None:
    assert adapt(bench, stream, tmp_path / "first.csv", "--stream", "hall-4") == 0

    assert adapt(bench, stream, tmp_path / "second.csv", "--stream", "hall-4") == 2
    assert not (tmp_path / "second.csv").exists()


def test_a_state_that_names_no_format_is_refused_in_one_line_that_says_what_to_do(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_registry(url(bench)) as registry:
        entry = {"stream": "hall-5", "sample": 400, "event": "checkpoint", "state": {"row": 400}, "began": 0}
        registry.adaptations.add(A1, 1, [entry])

    assert adapt(bench, stream, tmp_path / "out.csv", "--stream", "hall-5", "--resume") == 2

    error = capsys.readouterr().err
    assert "'hall-5'" in error and "--stream" in error and error.count("\n") == 1
    assert not (tmp_path / "out.csv").exists()
    assert adapt(bench, stream, tmp_path / "out.csv", "--stream", "hall-6") == 0


def test_a_file_that_names_its_own_stream_is_followed_once_however_often_it_comes(bench, stream, tmp_path) -> None:
    with open_registry(url(bench)) as registry:
        steps = []
        for name in ("first", "again"):
            assert adapt(bench, stream, tmp_path / f"{name}.csv", "--resume") == 0
            steps.append(len(registry.adaptations.all(A1)))
    assert steps[0] == steps[1] > 0
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "again.csv").read_bytes()


def test_figure_stands_alone(bench: Path, stream: Path, tmp_path: Path) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", "--html", str(tmp_path / "drift.html")) == 0

    page = (tmp_path / "drift.html").read_text()
    assert "Plotly.newPlot" in page and 'src="http' not in page


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"t_s,output\n" + b"0.0,abc\n" * 40, "'output'"),
        (b"t_s,output\n0.0,0.5\n0.02,0.5\n", " 15"),
        (bytes(range(256)) * 20, "in.csv"),
    ],
)
def test_what_is_no_recording_is_refused_in_one_line(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes, message: str
) -> None:
    (tmp_path / "in.csv").write_bytes(content)

    code = adapt(bench, tmp_path / "in.csv", tmp_path / "out.csv")

    error = capsys.readouterr().err
    assert code == 2
    assert message in error and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == [tmp_path / "in.csv"]


def test_unknown_serial_and_missing_file_are_refused(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", serial="NOBODY") == 2
    assert "NOBODY" in capsys.readouterr().err
    assert adapt(bench, tmp_path / "nowhere.csv", tmp_path / "out.csv") == 2
    assert "nowhere.csv" in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()


def test_a_stream_resumed_under_other_numbers_says_which_and_goes_on(bench: Path, stream: Path, tmp_path: Path) -> None:
    other = replace(DriftTracking(), drift=replace(DriftTracking().drift, pace=13.0))
    with open_registry(url(bench)) as registry:
        first = AdaptOptions(stream="numbers")
        adapt_file(registry, "A1", stream, tmp_path / "first.csv", first)
        resumed = AdaptOptions(AdaptConfig(method=other), stream="numbers", resume=True)

        report = adapt_file(registry, "A1", stream, tmp_path / "second.csv", resumed)

        course = registry.adaptations.all(A1, "numbers")
        again = adapt_file(registry, "A1", stream, tmp_path / "third.csv", resumed)
        changes = [step for step in registry.adaptations.all(A1, "numbers") if step["event"] == "method"]
    (changed,) = report.changed
    assert all(text in changed for text in ("drift.pace", "12.0", "13.0")) and again.changed == []
    assert len(changes) == 1 and changed in changes[0]["reason"]
    assert {step["method"] for step in course} == {DriftTracking().id, other.id}
    assert course[-1]["state"]["method"] == json.loads(json.dumps(other.to_json()))


def test_the_method_is_named_in_the_report(bench: Path, stream: Path, tmp_path: Path) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", "--json", str(tmp_path / "out.json")) == 0

    report = json.loads((tmp_path / "out.json").read_text())
    assert report["method"]["id"] == DriftTracking().id
    assert DriftTracking.from_json(report["method"]["numbers"]) == DriftTracking()


@pytest.mark.parametrize("mode", QUEUES)
def test_queues_are_mapped_and_their_maps_are_in_the_registry(
    bench: Path, stream: Path, tmp_path: Path, mode: str
) -> None:
    report = tmp_path / "report.json"

    assert adapt(bench, stream, tmp_path / "out.csv", "--mode", mode, "--queue", "200", "--json", str(report)) == 0

    rows, stream_rows = pd.read_csv(tmp_path / "out.csv"), pd.read_csv(stream)
    assert list(rows.columns) == ["t_s", "estimate", "lower", "upper", "flag"]
    np.testing.assert_allclose(rows["t_s"], stream_rows["t_s"])
    estimated = rows.dropna(subset=["estimate"])
    assert len(estimated) == len(stream_rows) - 14
    assert ((estimated["lower"] <= estimated["estimate"]) & (estimated["estimate"] <= estimated["upper"])).all()
    content = json.loads(report.read_text())
    assert content["mode"] == mode
    # Queues of 200 windows of random presses differ by chance: each swap is a step, and says so.
    swaps = sum(content["verdicts"].get(name, 0) for name in ("followed", "unwatched"))
    assert swaps == (len(stream_rows) - 14) // QUEUE - 1
    assert content["method"]["numbers"]["online"]["queue"] == QUEUE


@pytest.mark.parametrize("mode", QUEUES)
def test_a_shorter_file_has_the_same_first_rows_of_every_queue(
    bench: Path, stream: Path, tmp_path: Path, mode: str
) -> None:
    more = ("--mode", mode, "--queue", "200")
    pd.read_csv(stream).head(700).to_csv(tmp_path / "half.csv", index=False)

    adapt(bench, stream, tmp_path / "whole-out.csv", *more)
    adapt(bench, tmp_path / "half.csv", tmp_path / "half-out.csv", *more)

    whole, half = ((tmp_path / f"{name}-out.csv").read_text().splitlines() for name in ("whole", "half"))
    assert half == whole[:701]


@pytest.mark.parametrize("mode", QUEUES)
def test_until_the_first_swap_the_rows_are_those_without_adaptation(
    bench: Path, stream: Path, tmp_path: Path, mode: str
) -> None:
    adapt(bench, stream, tmp_path / "ot.csv", "--mode", mode, "--queue", "200")
    adapt(bench, stream, tmp_path / "none.csv", "--mode", "none")

    ot, none = (pd.read_csv(tmp_path / f"{name}.csv")["estimate"] for name in ("ot", "none"))
    swap = 14 + 2 * QUEUE
    np.testing.assert_allclose(ot[:swap], none[:swap], rtol=1e-9)
    assert not np.allclose(ot[swap + 32 :], none[swap + 32 :])


@pytest.mark.parametrize("mode", layered(QUEUES, ("ot",)))
def test_next_file_goes_on_with_the_queue_of_the_last(bench: Path, stream: Path, tmp_path: Path, mode: str) -> None:
    rows = pd.read_csv(stream)
    rows.head(480).to_csv(tmp_path / "first.csv", index=False)
    rows.iloc[480:].to_csv(tmp_path / "second.csv", index=False)
    more = ("--mode", mode, "--queue", "200", "--stream", f"days-{mode}", "--resume")

    for name in ("first", "second"):
        assert adapt(bench, tmp_path / f"{name}.csv", tmp_path / f"{name}-out.csv", *more) == 0

    adapt(bench, tmp_path / "second.csv", tmp_path / "fresh.csv", "--mode", mode, "--queue", "200")
    second, fresh = (pd.read_csv(tmp_path / f"{name}.csv")["estimate"] for name in ("second-out", "fresh"))
    assert not np.allclose(second[20:150], fresh[20:150])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--mode", "ot", "--queue", "14"), "15"),
        (("--mode", "ot-improved", "--queue", "100000"), "100014 rows"),
        (("--mode", "none", "--queue", "200"), "--queue"),
    ],
)
def test_a_queue_that_cannot_be_is_refused_in_one_line(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], message: str
) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", *more) == 2

    error = capsys.readouterr().err
    (line,) = (line for line in error.splitlines() if line.startswith("softcal"))
    assert message in line
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.long
def test_queues_of_another_length_are_not_gone_on_with(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    more = ("--mode", "ot", "--stream", "one-length")
    assert adapt(bench, stream, tmp_path / "out.csv", *more, "--queue", "200") == 0

    assert adapt(bench, stream, tmp_path / "more.csv", *more, "--queue", "300", "--resume") == 2

    assert "200 windows" in capsys.readouterr().err


@pytest.mark.long
def test_the_state_of_another_mode_is_refused(
    bench: Path, stream: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert adapt(bench, stream, tmp_path / "out.csv", "--mode", "ot", "--stream", "one-mode") == 0
    capsys.readouterr()

    for mode in ("ot-improved", "improved"):
        assert adapt(bench, stream, tmp_path / "more.csv", "--mode", mode, "--stream", "one-mode", "--resume") == 2
        assert "'one-mode'" in capsys.readouterr().err
