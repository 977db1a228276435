"""What every command shares: CSV and JSON apart from words, tables that fit, suggestions, completion, examples."""

import csv
import fcntl
import io
import json
import os
import pty
import re
import shlex
import shutil
import struct
import subprocess
import sys
import termios
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.charts.lot_page import lot_page
from softcal.app.cli.main import COMMANDS, command_parser, main
from softcal.app.cli.parser import suggestion
from softcal.app.texts.catalogue import text
from softcal.app.views.lot import lot_view
from softcal.db.connection import open_registry


@pytest.fixture(scope="module")
def calibrated(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `lot/` and `registry.db` in which the small lot was batched."""
    folder = Path(shutil.copytree(trained_lot, tmp_path_factory.mktemp("batched") / "here"))
    main(["batch", str(folder / "lot"), "--registry", f"sqlite:///{folder / 'registry.db'}", "--hidden", "16,8"])
    return folder


def _url(folder: Path) -> str:
    return f"sqlite:///{folder / 'registry.db'}"


def test_csv_on_standard_output_is_the_table_and_nothing_else(
    calibrated: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lot = str(calibrated / "lot")
    assert main(["batch", lot, "--registry", _url(calibrated), "--hidden", "16,8", "--csv", "-"]) in (0, 1)
    out = capsys.readouterr()
    rows = list(csv.reader(io.StringIO(out.out)))
    assert [row[0] for row in rows] == ["serial", "A1", "A2", "A3"] and len({len(row) for row in rows}) == 1
    assert out.err


def test_what_people_read_of_a_batch_fits_a_page(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(calibrated, tmp_path / "flat"))
    unit = pd.read_csv(folder / "lot/units/A2.csv")
    unit.assign(output=unit["output"].clip(upper=unit["output"].median())).to_csv(
        folder / "lot/units/A2.csv", index=False
    )
    main(["batch", str(folder / "lot"), "--registry", _url(folder), "--hidden", "16,8"])
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("A2 ") for line in lines) and max(map(len, lines)) <= 100, max(lines, key=len)


def test_a_command_names_the_registry_only_where_it_wrote_something(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path(shutil.copytree(calibrated, tmp_path / "again"))
    with open_registry(_url(folder)) as registry:
        before = registry.trail.heads()
        main(["batch", str(folder / "lot"), "--registry", _url(folder), "--hidden", "16,8"])
        assert registry.trail.heads() == before
        assert _url(folder) not in capsys.readouterr().err
        # Another network: written.
        main(["train", str(folder / "lot"), "--registry", _url(folder), "--hidden", "8"])
        assert registry.trail.heads() != before
        assert _url(folder) in capsys.readouterr().err


def test_json_on_standard_output_is_json_and_nothing_else(
    calibrated: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table = tmp_path / "table.csv"
    lot = str(calibrated / "lot")
    main(["batch", lot, "--registry", _url(calibrated), "--hidden", "16,8", "--json", "-", "--csv", str(table)])
    assert {unit["serial"] for unit in json.loads(capsys.readouterr().out)["units"]} == {"A1", "A2", "A3"}
    assert len(table.read_text().splitlines()) == 4


@pytest.mark.parametrize("output", [["stdout"], ["stderr"], ["stdout", "stderr"]])
@pytest.mark.parametrize("command", [["gap", "effects"], ["registry", "list"], ["batch", "lot", "--out", "files"]])
def test_a_reader_that_leaves_costs_no_file(calibrated: Path, tmp_path: Path, command: list[str], output: list[str]):
    """As `softcal ... | head`: what was asked for is written, and the exit code is that of the command."""
    report = tmp_path / "report.json"
    environment = os.environ | {"SOFTCAL_REGISTRY": _url(calibrated)}
    arguments = [sys.executable, "-m", "softcal.app.cli.main", *command, "--json", str(report)]
    read = subprocess.run(arguments, cwd=calibrated, env=environment, capture_output=True)
    expected = json.loads(report.read_text())
    report.unlink()
    far, near = os.pipe()
    os.close(far)
    with os.fdopen(near, "wb") as closed:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | dict.fromkeys(output, closed)
        left = subprocess.run(arguments, cwd=calibrated, env=environment, **streams)
    assert left.returncode == read.returncode
    assert json.loads(report.read_text()).keys() == expected.keys()


def test_rows_without_an_end_are_made_for_nobody(calibrated: Path) -> None:
    arguments = [sys.executable, "-m", "softcal.app.cli.main", "adapt", "--registry", _url(calibrated)]
    arguments += ["--serial", "A2", "-", "--out", "-"]
    adapt = subprocess.Popen(
        arguments, cwd=calibrated, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    assert adapt.stdin is not None and adapt.stdout is not None
    adapt.stdout.close()
    with suppress(BrokenPipeError), adapt.stdin:
        for k in range(20_000):
            adapt.stdin.write(f"{k / 50},{0.5 + 0.001 * (k % 100)}\n".encode())
            adapt.stdin.flush()
    assert adapt.wait(timeout=60) == 0


def test_one_standard_output_is_not_given_twice(calibrated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["registry", "list", "--registry", _url(calibrated), "--json", "-", "--csv", "-"]) == 2
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1


def _on_a_terminal(arguments: list[str], columns: int, **environment: str) -> str:
    """Run softcal on a terminal of so many columns and return what it showed."""
    near, far = pty.openpty()
    fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    base_env = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "NO_COLOR", "FORCE_COLOR")}
    code = "import sys; from softcal.app.cli.main import main; sys.exit(main(sys.argv[1:]))"
    process = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        stdin=far, stdout=far, stderr=subprocess.DEVNULL, env={**base_env, "TERM": "xterm-256color", **environment},
    )  # fmt: skip
    os.close(far)
    screen = b""
    try:
        while part := os.read(near, 4096):
            screen += part
    except OSError:
        pass  # the terminal is closed with its last process
    process.wait(60)
    os.close(near)
    return screen.decode()


@pytest.mark.parametrize("columns", [60, 100])
def test_a_table_fits_the_terminal_and_loses_no_letter(calibrated: Path, columns: int) -> None:
    screen = _on_a_terminal(["registry", "list", "--registry", _url(calibrated)], columns, NO_COLOR="1")
    assert "\x1b[" not in screen
    assert max(len(line) for line in screen.splitlines()) <= columns
    assert "…" not in screen


def test_verdicts_have_a_colour_unless_it_is_refused(calibrated: Path) -> None:
    assert "\x1b[3" in _on_a_terminal(["registry", "list", "--registry", _url(calibrated)], 200)


@pytest.mark.parametrize(
    ("arguments", "suggested_name"),
    [
        (["batc", "lot-1"], "batch"),
        (["registry", "lst"], "list"),
        (["batch", "lot-1", "--engin", "dask", "--anchor"], None),
        (["batch", "lot-1", "--hiden", "16"], "--hidden"),
        (["batch", "lot-1", "--engine", "dsk"], "dask"),
        (["estimate", "in.csv", "--serial", "A", "--out", "o.csv", "--ouput-column=v"], "--output-column"),
        (["quality", "yeild"], "yield"),
    ],
)
def test_a_mistyped_name_gets_a_suggestion(
    arguments: list[str], suggested_name: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    if suggested_name is None:  # a unique beginning is no mistake
        command_parser().parse_args([*arguments, "file.csv"])
        return
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    assert suggestion(suggested_name, [suggested_name]) in capsys.readouterr().err


def test_what_is_like_nothing_gets_no_suggestion() -> None:
    assert suggestion("zzzz", ["batch", "list"]) == ""


def test_the_help_of_a_command_is_the_same_whether_the_others_are_known_or_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for module in COMMANDS:
        command = module.rstrip("_")
        for parse in (command_parser().parse_args, main):
            with pytest.raises(SystemExit):
                parse([command, "--help"])
        helps = capsys.readouterr().out
        assert helps[: len(helps) // 2] == helps[len(helps) // 2 :], command


def test_a_configuration_file_is_checked_whole_whichever_command_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("softcal.toml").write_text('[batch]\nengine = "dask"\n')
    with pytest.raises(SystemExit) as ended:
        main(["registry", "--help"])
    assert ended.value.code == 0
    Path("softcal.toml").write_text('[batch]\nengin = "dask"\n')
    assert main(["registry", "--help"]) == 2
    assert "engin" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_every_command(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(word in script for word in ("batch", "estimate", "report", "sample-rate"))


def test_bash_completes_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["completion", "bash"])
    (tmp_path / "softcal.sh").write_text(capsys.readouterr().out)
    script = (
        "source softcal.sh; COMP_WORDS=(softcal est); COMP_CWORD=1; "
        "f=$(complete -p softcal | sed 's/.*-F \\([^ ]*\\).*/\\1/'); $f softcal est softcal; echo ${COMPREPLY[@]}"
    )
    process = subprocess.run(["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True)
    assert process.stdout.split() == ["estimate"], process.stderr


def _examples(command: str) -> list[list[str]]:
    """Return the commands that `softcal COMMAND --help` gives as examples, as a shell would split them."""
    actions = command_parser()._subparsers._group_actions[0]  # type: ignore[union-attr]
    epilog = (actions.choices[command].epilog or "").replace("\\\n", " ")  # type: ignore[index]
    return [shlex.split(line.strip()) for line in epilog.splitlines() if line.strip().startswith("softcal import")]


def test_the_examples_of_import_work_as_written(
    tmp_path: Path,
    press_unit,
    monkeypatch: pytest.MonkeyPatch,
    measured_data: Path,  # type: ignore[no-untyped-def]
) -> None:
    monkeypatch.chdir(tmp_path)
    for k in (1, 2):
        table = press_unit(600, 1 + 0.1 * k, 0.5, k).rename(columns={"output": "output_V", "reference": "force_N"})
        table.drop(columns="t_s").to_csv(f"S{k}.csv", index=False)
    (tmp_path / "insole.parquet").symlink_to(measured_data / "insole_lot" / "calibration.parquet")
    examples = _examples("import")
    assert len(examples) == 2
    for arguments in examples:
        assert main(arguments[1:]) == 0, arguments
    assert len(list((tmp_path / "lot-1" / "units").iterdir())) == 1
    assert len(list((tmp_path / "lot-2" / "units").iterdir())) > 10


def test_one_recording_under_two_serials_is_remarked(
    tmp_path: Path,
    press_unit,
    capsys: pytest.CaptureFixture[str],  # type: ignore[no-untyped-def]
) -> None:
    press_unit(600, 1.0, 0.5, 1).to_csv(tmp_path / "S1.csv", index=False)
    for name in ("S2", "S3"):
        press_unit(600, 1.1, 0.5, 2).to_csv(tmp_path / f"{name}.csv", index=False)
    files = [str(tmp_path / f"S{k}.csv") for k in (1, 2, 3)]
    options = ["--source", "S1", "--reference-column", "reference", "--time-column", "t_s"]
    assert main(["import", *files, *options, "--out", str(tmp_path / "lot")]) == 0
    assert "S2 (lot), S3 (lot)" in capsys.readouterr().err


def _logged(calibrated: Path, folder: Path) -> Path:
    """The unit's recording as a logger wrote it: other names, no t_s."""
    table = pd.read_csv(calibrated / "lot/units/A1.csv").rename(columns={"output": "output_V", "t_s": "when_s"})
    table["note"] = "x"
    table[["note", "output_V", "when_s"]].to_csv(folder / "logged.csv", index=False)
    return folder / "logged.csv"


@pytest.mark.parametrize("command", ["estimate", "adapt"])
@pytest.mark.parametrize("time", [("--time-column", "when_s"), ("--sample-rate", "50")])
def test_tables_of_an_instrument_are_taken_as_import_takes_them(
    calibrated: Path, tmp_path: Path, command: str, time: tuple[str, str]
) -> None:
    arguments = [command, "--serial", "A1", "--registry", _url(calibrated)]
    plain, renamed = tmp_path / "plain.csv", tmp_path / "named.csv"
    assert main([*arguments, str(calibrated / "lot/units/A1.csv"), "--out", str(plain)]) == 0
    logged = str(_logged(calibrated, tmp_path))
    assert main([*arguments, logged, "--output-column", "output_V", *time, "--out", str(renamed)]) == 0
    expected, converted = pd.read_csv(plain), pd.read_csv(renamed)
    assert expected["estimate"].notna().sum() > 1000
    np.testing.assert_allclose(converted["estimate"], expected["estimate"], rtol=1e-9)
    np.testing.assert_allclose(converted["t_s"], expected["t_s"], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "texts"),
    [
        (("estimate", "--output-column", "volts"), "'volts'"),
        (("estimate", "--output-column", "output_V", "no time"), "'t_s'"),
        (("estimate", "--output-column", "output_V", "--sample-rate", "80"), "80 Hz"),
        (
            ("adapt", "--output-column", "output_V", "--sample-rate", "50", "--stream", "a", "--resume", "no time"),
            "--time-column",
        ),
        (("adapt", "--output-column", "note", "--sample-rate", "50"), "'x'"),
    ],
)
def test_a_wrong_column_or_rate_is_one_line(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], texts: str
) -> None:
    logged, (command, *rest) = _logged(calibrated, tmp_path), arguments
    if rest[-1] == "no time":
        rest.pop()
        # A column that rises in a unit of time would be taken as the time.
        pd.read_csv(logged).drop(columns="when_s").to_csv(logged, index=False)
    options = [str(logged), "--out", str(tmp_path / "out.csv")]
    assert main([command, "--serial", "A1", "--registry", _url(calibrated), *options, *rest]) == 2
    assert texts in capsys.readouterr().err
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize("language", ["en", "ko"])
def test_a_report_is_one_page_that_needs_nothing_else(calibrated: Path, tmp_path: Path, language: str) -> None:
    out = tmp_path / "report.html"
    arguments = ["report", str(calibrated / "lot"), "--out", str(out), "--language", language]
    assert main([*arguments, "--registry", _url(calibrated)]) == 0
    page = out.read_text(encoding="utf-8")
    assert "<script" not in page and len(page) < 500_000
    assert not re.search(r"(src|href)\s*=\s*['\"]?(https?:)?//", page)
    assert all(f"<td>{serial}</td>" in page for serial in ("A1", "A2", "A3"))
    assert "<svg class='drawing'" in page


def test_a_report_escapes_what_a_lot_and_its_units_are_called(calibrated: Path) -> None:
    with open_registry(_url(calibrated)) as registry:
        view = lot_view(registry, "small")
        units = [replace(unit, serial="<i>serial") for unit in registry.lots.units("small")]
    renamed = replace(view, lot=replace(view.lot, sensor_model="<i>model"))
    page = lot_page(renamed, units, partial(text, "en"), "<i>made")
    assert "<i>" not in page
    assert all(f"&lt;i&gt;{name}" in page for name in ("model", "serial", "made"))


def test_a_report_of_an_unknown_lot_is_one_line(calibrated: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", "lot-9", "--registry", _url(calibrated)]) == 2
    assert "lot-9" in capsys.readouterr().err


def test_a_row_without_a_sample_is_invalid_and_a_hole_in_time_stays(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = pd.read_csv(calibrated / "lot/units/A1.csv")
    table.loc[100, "output"] = np.nan
    table.loc[300:, "t_s"] += 2.0
    source, out = tmp_path / "in.csv", tmp_path / "out.csv"
    table.to_csv(source, index=False, sep=";", decimal=",")
    unit = ["--serial", "A1", "--registry", _url(calibrated), str(source), "--out", str(out)]
    for command in ("estimate", "adapt"):
        report = tmp_path / f"{command}.json"
        assert main([command, *unit, "--sample-rate", "50", "--json", str(report)]) == 0
        rows = pd.read_csv(out)
        flags = rows["flag"].fillna("").str.split("; ").str[0]
        np.testing.assert_array_equal(rows["t_s"], table["t_s"])
        assert flags[100] == "invalid" and flags[101] == "gap" and flags[300] == "gap"
        assert "semicolons; decimal comma" in capsys.readouterr().err
        assert json.loads(report.read_text())["layout"] == "semicolons; decimal comma"
    assert main(["estimate", *unit, "--sample-rate", "25"]) == 2
    assert "25 Hz" in capsys.readouterr().err
