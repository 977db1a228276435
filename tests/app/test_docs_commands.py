"""The commands in the documents: each can be copied into a shell; where no rig or server is needed it is run."""

import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import command_parser, main

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND = re.compile(r"(?:\w+=\S+ )*softcal (?P<words>.*)")
A_PACKAGE = {"--format ini": "the example package of the page brings the format"}
"""Parts of commands that only an installed package understands."""

ELSEWHERE = {
    "softcal ui": "tests/app/test_browser.py",
    "softcal station": "tests/app/test_station_command.py, test_station_serve.py",
    "softcal demo": "tests/app/test_demo.py",
    "softcal batch lot-1 --registry sqlite:///registry.db": "tests/app/test_rig_to_lot.py",
    "softcal gap diagnose": "tests/app/test_gap_command.py, test_gap_plugin.py, test_gap_simulator.py",
    "softcal gap apply": "tests/app/test_gap_command.py",
    "softcal gap transfer": "tests/app/test_gap_command.py",
    "softcal gap lot": "tests/app/test_gap_lot.py",
    "softcal gap challenge": "tests/app/test_gap_challenge.py",
    "softcal gap score": "tests/app/test_gap_challenge.py",
    "serial:/dev/ttyACM0": "tests/app/test_adapt_live.py",
    "tcp://127.0.0.1:7007": "tests/app/test_adapt_live.py",
    "--format ini": "tests/app/test_open_plugins.py",
    "--sign factory.pem": "tests/app/test_export_command.py",
    "--public-key factory.pub": "tests/app/test_export_command.py",
    "--scheduler tcp://": "tests/app/test_engine.py",
    "postgresql://": "tests/db/test_scale.py",
    "--origin": "tests/app/test_second_station.py",
    "softcal registry rollback": "tests/app/test_registry_command.py",
    "--registry sqlite:////var": "tests/app/test_registry_command.py",
    "softcal registry backup /backup": "tests/app/test_registry_command.py",
    "| psql": "tests/db/test_grants.py",
    "softcal quality capability": "tests/app/test_registry_command.py",
    "softcal quality golden": "tests/app/test_registry_command.py",
    "softcal api": "tests/app/test_connect_run.py, test_connect_rest.py",
    "softcal connect": "tests/app/test_connect_run.py, test_connect_mqtt.py",
    "--parquet": "tests/app/test_connect_run.py",
}
"""Commands that need a rig, a server, a package or a second station: part of the command → where they are tried."""


def _commands(page: Path) -> list[str]:
    """Return the commands of the blocks of a page, one line each, without their comments."""
    text = page.read_text(encoding="utf-8")
    found = []
    for block in re.findall(r"^```[a-z]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            if COMMAND.match(line.strip()):
                found.append(shlex.join(shlex.split(line, comments=True)).replace("'|'", "|"))
    return found


def _words(command: str) -> list[str]:
    words = shlex.split(command.partition(" | ")[0])
    return words[words.index("softcal") + 1 :]


def test_every_command_of_a_block_is_understood(capsys: pytest.CaptureFixture[str]) -> None:
    refused = []
    for page in PAGES:
        for command in _commands(page):
            if any(part in command for part in A_PACKAGE):
                continue
            try:
                command_parser().parse_args(_words(command))
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
        assert main(_words(command)) in (0, 1), command
        count += 1
    return count


def _import(*files: str) -> None:
    columns = ["--output-column", "output_V", "--reference-column", "force_N", "--sample-rate", "50"]
    assert main(["import", *files, "--source", "S1", *columns, "--audit", "--limit", "0.3", "--out", "lot-1"]) == 0


def test_the_readme_runs_as_written(workplace: Callable[[str], Path]) -> None:
    assert _run("README.md", workplace("S2")) == 7
    assert list(Path("files").glob("unit-*")), "the main job ends with files"


@pytest.mark.parametrize(
    ("page", "serial", "least"),
    [
        ("docs/engineer.md", "S2", 4),
        ("docs/long-term.md", "A1", 2),
        ("docs/registry.md", "A17", 7),
        ("docs/trust.md", "S2", 4),
        ("docs/verdict.md", "A1", 2),
    ],
)
def test_a_page_runs_as_written(workplace: Callable[[str], Path], page: str, serial: str, least: int) -> None:
    folder = workplace(serial)
    shutil.copy(folder / "plain.csv", folder / "new.csv")
    _import("S1.csv", f"{serial}.csv", "S3.csv")
    assert main(["batch", "lot-1"]) in (0, 1)
    assert _run(page, folder) >= least


def test_no_command_escapes_in_a_block_that_is_only_indented() -> None:
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
        assert not re.findall(r"^    softcal .*", text, re.MULTILINE), page


def test_every_command_is_run_as_written_or_tried_elsewhere() -> None:
    run = {
        "README.md", "docs/engineer.md", "docs/long-term.md", "docs/registry.md", "docs/trust.md", "docs/tutorial.md",
        "docs/verdict.md",
    }  # fmt: skip
    for page in PAGES:
        left = [c for c in _commands(page) if not any(part in c for part in ELSEWHERE)]
        alone = all(_words(c)[:2] == ["gap", "effects"] or _words(c)[0] in ("lot",) for c in left)
        assert str(page.relative_to(ROOT)) in run or alone, left
    for places in ELSEWHERE.values():
        first = places.partition(",")[0]
        assert (ROOT / first).is_file(), first
