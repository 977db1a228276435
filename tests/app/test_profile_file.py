"""Profiles as files: written, read back, pressed, and refused with the line that is wrong."""

import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.app.files.profile_file import profile_toml, read_profile
from softcal.core.errors import InputError
from softcal.core.profiles import BUILT_IN, moves


def read_back(folder, profile):
    path = folder / "p.toml"
    path.write_text(profile_toml(profile))
    return read_profile(path)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_profile_is_read_back_as_it_was_written(tmp_path, name):
    profile = BUILT_IN[name](np.random.default_rng(1), 3.0)
    profile_read = read_back(tmp_path, profile)
    t_s, stage_mm = profile.sample(50.0)
    assert (profile_read.name, profile_read.presses) == (profile.name, profile.presses)
    np.testing.assert_allclose(profile_read.position_mm(t_s), stage_mm, atol=1e-9)


@pytest.mark.parametrize("name", ['the "long" one', "one\\two", "two\nlines"])
def test_any_name_survives_its_file(tmp_path, name):
    assert read_back(tmp_path, moves(name, (1.0, 0.0), (2.0, 2.0), (0.5, 0.5))).name == name


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("moves = [[1.0, 2.0]]", "move 1 "),
        ("moves = [[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]", "move 2 "),
        ("moves = [[1.0, 2.0, -1.0]]", "move 1 "),
        ("moves = [['a', 2.0, 1.0]]", "move 1 "),
        ("moves = [[nan, 2.0, 1.0]]", "move 1 "),
        ("steps = []", "'steps'"),
        ("name = 'x'", "moves"),
        ("moves = [", "TOML"),
    ],
)
def test_what_makes_no_sense_is_named(tmp_path, content, message):
    path = tmp_path / "p.toml"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        read_profile(path)


def test_a_file_is_listed_written_edited_and_pressed(tmp_path, capsys):
    path, out = tmp_path / "touch.toml", tmp_path / "A1.csv"
    assert main(["station", "profiles"]) == 0
    assert "ramps" in capsys.readouterr().out
    assert main(["station", "profiles", "--write", "ramps", str(path)]) == 0
    path.write_text('name = "quick"\nmoves = [[0.0, 1.0, 0.5], [1.5, 4.0, 0.2], [0.0, 4.0, 0.5]]\n')
    command = ["station", "unit", "--simulated", "--serial", "A1", "--out", str(out), "--profile", str(path)]
    assert main([*command, "--spool", str(tmp_path)]) == 0
    assert out.exists()
    path.write_text("moves = [[9.5, 4.0, 0.2], [0.0, 4.0, 0.5]]\n")
    assert main([*command, "--spool", str(tmp_path)]) == 3
    assert "9.5 mm" in capsys.readouterr().err
