"""The tutorial as a reader follows it: every line of its blocks in order, and what they print has the shape shown."""

import re
import shlex
import shutil
from pathlib import Path

import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.line.demo import DemoConfig, press_demo_lot

pytestmark = pytest.mark.long

PAGE = Path(__file__).parents[2] / "docs/tutorial.md"
PRACTICE = DemoConfig(units=2)


def _blocks() -> list[tuple[str, str]]:
    """Return (language, text) of every block; commands have no language, what they print is `text`."""
    return re.findall(r"^```(\w*)\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def _follow(block: str) -> list[int]:
    """Run the lines of a block in this folder; return the exit codes of softcal's commands."""
    codes = []
    for line in block.replace("\\\n", " ").splitlines():
        arguments = shlex.split(line)
        if arguments[:2] == ["softcal", "demo"]:
            # The lot alone: what else the demo does is tried in test_demo.py.
            press_demo_lot(PRACTICE, Path(arguments[arguments.index("--out") + 1]) / "lot", lambda said: None)
        elif arguments[0] == "softcal":
            codes.append(main(arguments[1:]))
        elif arguments[0] == "cp":
            shutil.copy(arguments[1], arguments[2])
        else:
            assert arguments[0] == "mkdir", line
            Path(arguments[1]).mkdir()
    return codes


def _head(text: str) -> list[str]:
    return text.splitlines()[0].split()


def _without_numbers(text: str) -> list[str]:
    return [re.sub(r"\d[\d.e-]*", "0", line).strip() for line in text.splitlines()]


def test_the_tutorial_leads_from_files_to_a_device(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "softcal.toml").write_text('[batch]\nhidden = "16,8"\n', encoding="utf-8")
    codes, printed = [], ""
    for language, block in _blocks():
        if language == "text":
            lines = [" ".join(line.split()) for line in printed.splitlines()]
            if "serial" not in _head(block):
                assert {" ".join(x.split()) for x in _without_numbers(block) if "---" not in x} <= {
                    " ".join(x.split()) for x in _without_numbers("\n".join(lines))
                }
            else:
                assert " ".join(_head(block)) in lines
                # A serial with its verdict, or with why it is measured; numbers differ with every training.
                rows = [line.split()[:2] for line in block.splitlines()[2:] if re.match(r"A\d", line)]
                assert rows and all(any(line.split()[:2] == row for line in lines) for row in rows), printed
            continue
        codes += _follow(block)
        printed = "".join(capsys.readouterr())
    # Nothing passes before it was measured; then both do.
    assert codes == [0, 1, 0, 0, 0, 0, 0, 0, 0]
    assert set(pd.read_csv("force.csv")) == {"t_s", "estimate", "lower", "upper", "flag"}
    assert Path("why-A3.html").is_file()
    assert Path("device/unit-A2.h").is_file()
