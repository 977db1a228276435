"""The commands in the documents: each can be copied into a shell, and runs as written where no rig is needed."""

import json
import re
import shlex
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import command_parser, main
from softcal.core.profiles import Profile, ramps
from softcal.core.twin.parameters import BaseParameters, ReadoutMetadata
from softcal.core.twin.simulate import EffectSetting, Twin, simulate
from softcal.db.connection import open_registry

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
EXAMPLES = sorted((ROOT / "examples").glob("*/README.md"))
COMMAND = re.compile(r"(?:\w+=\S+ )*softcal (?P<words>.*)")
READOUT = ReadoutMetadata(3.3, 12, 10.0, 50.0)
A_PACKAGE = {"--format ini": "the example package of the page brings the format"}
"""Parts of commands that only an installed package understands."""

ELSEWHERE = {
    "softcal ui": "tests/app/test_browser.py",
    "softcal station": "tests/app/test_station_command.py, test_station_serve.py",
    "softcal demo": "tests/app/test_demo.py",
    "softcal batch lot-1 --registry sqlite:///registry.db": "tests/app/test_rig_to_lot.py",
    "--simulator": "tests/app/test_gap_simulator_page.py",
    "--report rig.gap.json": "tests/app/test_gap_simulator_report.py",
    "--empirical": "tests/app/test_gap_empirical.py",
    "softcal gap transfer": "tests/app/test_gap_command.py",
    "softcal gap challenge": "tests/app/test_gap_challenge.py",
    "softcal gap score": "tests/app/test_gap_challenge.py",
    "serial:/dev/ttyACM0": "tests/app/test_adapt_live.py",
    "tcp://127.0.0.1:7007": "tests/app/test_adapt_live.py",
    "--format ini": "tests/app/test_map_plugins.py",
    "--scheduler tcp://": "tests/app/test_engine.py",
    "postgresql://": "tests/db/test_scale.py",
    "--origin": "tests/app/test_second_station.py",
    "softcal registry rollback": "tests/app/test_registry_command.py",
    "--registry sqlite:////var": "tests/app/test_registry_command.py",
    "softcal registry backup /backup": "tests/app/test_registry_command.py",
    "| psql": "tests/db/test_grants.py",
    "softcal quality capability": "tests/app/test_registry_command.py",
    "softcal quality golden": "tests/app/test_registry_command.py",
    "softcal api serve": "tests/app/test_rest.py",
    "softcal api token withdraw": "tests/app/test_connect_service.py",
    "softcal connect check": "tests/app/test_connect_service.py, test_connect_mqtt.py",
    "softcal connect run": "tests/app/test_connect_service.py, test_connect_mqtt.py",
}
"""Commands that need a rig, a server, a package or a second station: part of the command → where they are tried."""

OTHER_PROGRAMS = {
    r"cp |mkdir ": "tests/app/test_tutorial.py",
    r"curl ": "tests/app/test_rest.py",
    r"docker compose ": "tests/house/test_deploy.py",
    r"logger ": "tests/app/test_connect_mqtt.py",
    r"openssl genpkey ": "tests/app/test_docs_commands.py",
    r"openssl pkeyutl ": "tests/app/test_export_command.py",
    r"pip install \S*examples/softcal-example-effect": "tests/app/test_gap_plugin.py",
    r"pip install \S*examples/softcal-example-driver|pytest ": "tests/station/test_driver_cookbook.py",
    r"(\.venv/bin/)?(pip|python3) |py -3|\.venv\\Scripts": "tests/house/test_light_install.py",
    r"for c in sealed": "tests/app/test_gap_challenge.py",
}
"""Commands of other programs: how they begin → where they, or what they stand for, are tried."""


def _commands(page: Path, command: re.Pattern[str] = COMMAND) -> list[str]:
    """Return the commands of the blocks of a page, one line each, without their comments."""
    return [
        shlex.join(shlex.split(line, comments=True)).replace("'|'", "|") for line in _lines(page) if command.match(line)
    ]


def _lines(page: Path) -> list[str]:
    """Return the lines of the blocks of a page that no language is said of."""
    blocks = re.findall(r"^ *```(\w*)\n(.*?)^ *```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    bare = [text.replace("\\\n", " ") for language, text in blocks if not language]
    return [line.strip() for text in bare for line in text.splitlines()]


def _arguments(command: str) -> list[str]:
    arguments = shlex.split(command.partition(" | ")[0])
    return arguments[arguments.index("softcal") + 1 :]


def test_every_command_of_a_block_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    refused = []
    for page in PAGES:
        for command in _commands(page):
            if any(part in command for part in A_PACKAGE):
                continue
            try:
                command_parser().parse_args(_arguments(command))
            except SystemExit:
                refused.append((page.name, command, capsys.readouterr().err))
    assert refused == []


@pytest.fixture
def workplace(
    tmp_path: Path, press_unit: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> Callable[[str], Path]:
    """`workplace(serial)`: the working folder of a reader whose second unit has that serial; networks are small."""
    tables = {name: press_unit(1500, 1 + 0.15 * k, 0.5 + 0.04 * k, k + 1) for k, name in enumerate(("S1", "S2", "S3"))}

    def make(serial: str) -> Path:
        for name, table in tables.items():
            table.rename(columns={"output": "output_V", "reference": "force_N"}).to_csv(tmp_path / f"{name}.csv")
        (tmp_path / "measured").mkdir()
        for name, table in ((serial, tables["S2"]), ("S3", tables["S3"])):
            both = table.assign(output_V=table["output"], force_N=table["reference"])
            both.to_csv(tmp_path / f"measured/{name}.csv", index=False)
        tables["S2"][["t_s", "output"]].to_csv(tmp_path / "plain.csv", index=False)
        tables["S2"].rename(columns={"output": "output_V"}).to_csv(tmp_path / "new.csv")
        for name in ("long", "week", "tuesday"):
            shutil.copy(tmp_path / "plain.csv", tmp_path / f"{name}.csv")
        _study().to_csv(tmp_path / "study.csv", index=False)
        (tmp_path / "softcal.toml").write_text(
            f'registry = "sqlite:///{tmp_path}/registry.db"\n[batch]\nhidden = "16,8"\n', encoding="utf-8"
        )
        monkeypatch.chdir(tmp_path)
        monkeypatch.delenv("SOFTCAL_REGISTRY", raising=False)
        if serial != "S2":
            shutil.move("S2.csv", f"{serial}.csv")
        return tmp_path

    return make


def _study() -> pd.DataFrame:
    rng = np.random.default_rng(5)
    rows = [(u, s, t) for u in range(10) for s in ("line-1", "line-2", "line-3") for t in (1, 2, 3)]
    values = [10 + u + 0.1 * rng.normal() for u, _, _ in rows]
    return pd.DataFrame(rows, columns=["unit", "station", "trial"]).assign(value=values)


def _run(page: str, workplace: Path) -> int:
    """Run the commands of a page in their order; return how many."""
    count = 0
    for command in _commands(ROOT / page):
        if any(part in command for part in ELSEWHERE):
            continue
        assert main(_arguments(command)) in (0, 1), command
        count += 1
    return count


def _import(*files: str, out: str = "lot-1") -> None:
    columns = ["--output-column", "output_V", "--reference-column", "force_N", "--sample-rate", "50"]
    assert main(["import", *files, "--source", "S1", *columns, "--audit", "--limit", "0.3", "--out", out]) == 0


def test_the_readme_runs_as_written(workplace: Callable[[str], Path]) -> None:
    assert _run("README.md", workplace("S2")) == 7
    assert list(Path("files").glob("unit-*")), "the main job ends with files"


@pytest.mark.parametrize(
    ("page", "serial", "min_windows"),
    [
        ("docs/connect.md", "A1", 5),
        pytest.param("docs/engineer.md", "S2", 4, marks=pytest.mark.long),
        ("docs/firmware.md", "A1", 1),
        pytest.param("docs/format.md", "S2", 2, marks=pytest.mark.long),
        pytest.param("docs/long-term.md", "A1", 2, marks=pytest.mark.long),
        pytest.param("docs/registry.md", "A17", 7, marks=pytest.mark.long),
        pytest.param("docs/trust.md", "S2", 4, marks=pytest.mark.long),
        pytest.param("docs/verdict.md", "A1", 2, marks=pytest.mark.long),
    ],
)
def test_a_page_runs_as_written(
    workplace: Callable[[str], Path], page: str, serial: str, min_windows: int, require_program: Callable[..., str]
) -> None:
    folder = workplace(serial)
    shutil.copy(folder / "plain.csv", folder / "new.csv")
    _import("S1.csv", f"{serial}.csv", "S3.csv")
    assert main(["batch", "lot-1"]) in (0, 1)
    with open_registry(f"sqlite:///{folder}/registry.db") as registry:
        registry.people.set("MES", "operator", "2580", actor="kim")
    for line in _commands(ROOT / page, re.compile("openssl gen")):
        require_program("openssl")
        subprocess.run(line.replace("'&&'", "&&"), shell=True, check=True, capture_output=True)
    assert _run(page, folder) >= min_windows


@pytest.mark.long
def test_the_rules_of_a_line_are_set_as_written(workplace: Callable[[str], Path]) -> None:
    folder = workplace("S2")
    _import("S1.csv", "S2.csv", "S3.csv", out="LOT-1")
    assert main(["batch", "LOT-1"]) in (0, 1)
    assert _run("docs/station-service.md", folder) == 2


@pytest.mark.long
def test_a_gap_is_diagnosed_as_written(workplace: Callable[[str], Path]) -> None:
    folder = workplace("S2")
    for case in ("rig-7", "lot-7/A1", "lot-7/A2"):
        for run, profile in enumerate((ramps([3.0] * 2, 0.8), ramps([3.0] * 5, 4.0)), start=1):
            _press(folder / case / "runs" / str(run), profile, run)
    assert _run("docs/gap.md", folder) >= 4
    assert _run("docs/own-effect.md", folder) == 2


def _press(folder: Path, profile: Profile, seed: int) -> None:
    """Record a run of a rig whose readout lags."""
    t_s, stage_mm = profile.sample(50.0)
    twin = Twin(BaseParameters(kappa_per_N=0.06), (EffectSetting("readout_lag", {"tau": 0.1}),), READOUT)
    force_N, output_V = simulate(twin, t_s, stage_mm, np.random.default_rng(seed))
    folder.mkdir(parents=True)
    table = pd.DataFrame({"t_s": t_s, "stage_mm": stage_mm, "force_N": force_N, "output_V": output_V})
    table.to_csv(folder / "recording.csv", index=False)
    values = {"vref_V": 3.3, "adc_bits": 12, "r_series_ohm": 10.0, "sample_rate_Hz": 50.0, "serial": folder.parts[-3]}
    (folder / "recording.json").write_text(json.dumps(values), encoding="utf-8")


def test_no_command_escapes_in_a_block_that_is_only_indented() -> None:
    for page in PAGES:
        text = re.sub(r"^ *```.*?^ *```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^    softcal .*", text, re.MULTILINE), page


def test_every_command_is_run_as_written_or_tried_elsewhere() -> None:
    run = {
        "README.md", "docs/connect.md", "docs/engineer.md", "docs/firmware.md", "docs/format.md", "docs/gap.md",
        "docs/long-term.md", "docs/own-effect.md", "docs/registry.md", "docs/station-service.md", "docs/trust.md",
        "docs/tutorial.md", "docs/verdict.md",
    }  # fmt: skip
    for page in [*PAGES, *EXAMPLES]:
        unchecked = [c for c in _commands(page) if not any(part in c for part in ELSEWHERE)]
        assert str(page.relative_to(ROOT)) in run or unchecked == [], unchecked
    for files in [*ELSEWHERE.values(), *OTHER_PROGRAMS.values()]:
        first = files.partition(",")[0]
        assert (ROOT / first).is_file(), first


def test_every_command_of_another_program_is_tried_too() -> None:
    programs = re.compile(
        r"(\S*\b(cp|mkdir|curl|docker|logger|openssl|pip|py|pytest|python3?|for|cd|jupytext)\b|\S+\\Scripts)"
    )
    unchecked = [(page.name, line) for page in [*PAGES, *EXAMPLES] for line in _lines(page) if programs.match(line)]
    assert [one for one in unchecked if not any(re.match(begins, one[1]) for begins in OTHER_PROGRAMS)] == []


def test_every_target_of_make_that_a_page_names_exists() -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    pages = [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"]
    documented = {
        t for page in pages for t in re.findall(r"(?:^|`)make ([a-z-]+)", page.read_text("utf-8"), re.MULTILINE)
    }
    assert documented and documented <= targets
