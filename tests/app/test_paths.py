"""Nothing read from a lot, a manifest or an archive reaches outside its folder; secrets stay with their owner."""

import os
import stat

import pytest

from softcal.app.cli.main import main
from softcal.core.errors import RegistryError
from softcal.db.connection import open_registry
from softcal.db.maintenance.backup import back_up, restore


@pytest.mark.parametrize("name", ["lot.toml", "source/A0.csv"])
@pytest.mark.parametrize("kind", ["link", "pipe", "device"])
def test_what_a_lot_begins_with_is_a_file_of_its_folder(lot_folder, tmp_path, capsys, name, kind):
    path = lot_folder / name
    path.rename(tmp_path / "elsewhere")
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(tmp_path / "elsewhere" if kind == "link" else "/dev/zero")
    url = f"sqlite:///{tmp_path / 'fresh.db'}"
    assert main(["train", str(lot_folder), "--registry", url, "--hidden", "16,8"]) == 2
    assert path.name in capsys.readouterr().err.strip().splitlines()[-1]


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "# long\n" * 200_000])
def test_a_lot_toml_without_end_is_refused(lot_folder, capsys, text):
    (lot_folder / "lot.toml").write_text(text)
    assert main(["batch", str(lot_folder), "--registry", "sqlite://"]) == 2
    assert "lot.toml" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="file modes are those of POSIX")
def test_a_registry_and_every_copy_of_it_belong_to_their_owner_alone(tmp_path):
    before = os.umask(0)
    try:
        with open_registry(f"sqlite:///{tmp_path / 'registry.db'}") as registry:
            registry.people.set("kim", "operator", "2580", actor="lee")
            back_up(registry.database, tmp_path / "backup.db")
            restore(tmp_path / "backup.db", f"sqlite:///{tmp_path / 'restored.db'}")
            # While it is open, the log beside it holds what was written last.
            modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()}
    finally:
        os.umask(before)
    assert {"registry.db", "registry.db-wal", "backup.db", "restored.db"} <= set(modes)
    assert {name: oct(mode) for name, mode in modes.items() if mode != 0o600} == {}


@pytest.mark.parametrize(
    "url",
    [
        "postgresql://nobody:hush@127.0.0.1:1/x",
        "postgresql://nobody@127.0.0.1:1/x?password=hush",
        "postgresql://nobody:hush@127.0.0.1:port/x",
        "postgresql://nobody:hush@/x?host=/no/such/socket",
        "mysql://nobody:hush@localhost/x",
        "hush",
    ],
)
@pytest.mark.parametrize("command", ["list", "verify", "sync"])
def test_a_database_s_password_is_in_no_error(url, command, tmp_path, capsys):
    open_registry(f"sqlite:///{tmp_path / 'here.db'}").close()
    where = ["--registry", f"sqlite:///{tmp_path / 'here.db'}", "--with", url]
    assert main(["registry", command, *(where if command == "sync" else ["--registry", url])]) == 4
    printed = "".join(capsys.readouterr())
    assert "hush" not in printed and len(printed.strip().splitlines()) == 1
    with pytest.raises(RegistryError):
        open_registry(url)


def test_what_people_wrote_is_shown_and_not_obeyed(calibrated, capsys):
    with open_registry(calibrated) as registry:
        lot = registry.lots.units()[0].lot_id
        registry.lots.set_limit(lot, 0.5, reason="\x1b[2Jagreed\x07\r\x9b31m", actor="\x1b]0;kim\x07")
        serial = next(unit.serial for unit in registry.lots.units() if unit.verdict)
        registry.calibrations.refuse(lot, serial, "retest", ("\x1b[31mred\x9b",))
    capsys.readouterr()
    for command in (["list"], ["history", "--serial", serial], ["verify"]):
        main(["registry", *command, "--registry", calibrated])
        printed = "".join(capsys.readouterr())
        assert printed and not [c for c in printed if c != "\n" and (ord(c) < 32 or 0x7F <= ord(c) < 0xA0)], command
