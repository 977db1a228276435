"""Configuration files: what outranks what, and that a wrong file is one clear line."""

from pathlib import Path

import pytest

from softcal.app.cli.configuration import configure
from softcal.app.cli.main import command_parser, main


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder; the user's configuration folder is `config` in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.delenv("SOFTCAL_REGISTRY", raising=False)
    return tmp_path


def _write_user(folder: Path, text: str) -> None:
    (folder / "config/softcal").mkdir(parents=True)
    (folder / "config/softcal/softcal.toml").write_text(text)


def _parsed(*arguments: str) -> object:
    parser = command_parser()
    configure(parser)
    return parser.parse_args(arguments)


def test_the_file_here_outranks_the_file_of_the_user_and_an_option_outranks_both(folder: Path) -> None:
    _write_user(folder, 'registry = "sqlite:///user.db"\n[batch]\njobs = 3\n')
    assert vars(_parsed("batch", "lot"))["registry"] == "sqlite:///user.db"
    (folder / "softcal.toml").write_text('registry = "sqlite:///here.db"\n')
    options = vars(_parsed("batch", "lot"))
    assert (options["registry"], options["jobs"]) == ("sqlite:///here.db", 3)
    assert vars(_parsed("batch", "lot", "--registry", "sqlite:///typed.db"))["registry"] == "sqlite:///typed.db"


def test_the_environment_outranks_the_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOFTCAL_REGISTRY", "sqlite:///environment.db")
    (folder / "softcal.toml").write_text('registry = "sqlite:///here.db"\n')
    assert vars(_parsed("batch", "lot"))["registry"] is None


def test_an_option_that_is_needed_can_stand_in_the_file(folder: Path) -> None:
    (folder / "softcal.toml").write_text('[import]\nout = "lot-1"\nsample-rate = 50\n')
    options = vars(_parsed("import", "a.csv", "--source", "S1"))
    assert (options["out"], options["sample_rate"]) == (Path("lot-1"), 50.0)


def test_a_list_is_for_options_that_take_several(folder: Path) -> None:
    (folder / "softcal.toml").write_text('[station.unit]\nserial = ["A1", "A2"]\n')
    assert vars(_parsed("station", "unit", "--out", "x"))["serial"] == ["A1", "A2"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("registri = 'x'", "registri"),
        ("[bach]\njobs = 3", "bach"),
        ("[batch]\njobs = 'many'", "'many'"),
        ("[batch]\nengine = 'dusk'", "dusk"),
        ("[batch]\njobs = [1, 2]", "jobs"),
        ("registry = true", "registry"),
        ("[batch]\nrefit = true", "--refit"),
        ("registry = ", "TOML"),
    ],
)
def test_a_wrong_file_is_one_line(folder: Path, capsys: pytest.CaptureFixture[str], text: str, message: str) -> None:
    (folder / "softcal.toml").write_text(text)
    assert main(["doctor"]) == 2
    error = capsys.readouterr().err
    assert message in error and "softcal.toml" in error and error.count("\n") == 1


def test_doctor_names_the_files_in_use(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "softcal.toml").write_text(f'registry = "sqlite:///{folder}/here.db"\n')
    main(["doctor", "--json", "-"])
    assert '"softcal.toml"' in capsys.readouterr().out
