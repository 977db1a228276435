"""`softcal export` and `inspect` on a small calibrated lot: every format, the manifest, and all that is refused."""

import json
import re
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from softcal.app.calibration.changes import change_limit
from softcal.app.cli.main import main
from softcal.app.export import names as export_names
from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.export.check import INVALID, NOT_CHECKED, NOT_SIGNED, FolderCheck, check_folder
from softcal.app.export.export import export_units
from softcal.app.export.formats import WRITERS
from softcal.app.export.names import AUDIT
from softcal.app.export.signature import open_signing_key, read_trusted_keys
from softcal.core.errors import InputError
from softcal.core.export.json_text import network_from_values, unit_from_values
from softcal.core.export.loader import CLAMPED, OUT_OF_RANGE
from softcal.core.messages.reason import plain
from softcal.core.unit.fit import FittedMap
from softcal.core.unit.state_json import adjustments_to_json, fit_to_json
from softcal.core.unit.verdict import Finding, Verdict
from softcal.db.connection import open_registry
from tests.device_sensor import open_sensor

FORMATS = ("json", "c", "blob", "hex", "onnx", "pdf", "dcc")
Run = Callable[..., int]


@pytest.fixture(scope="module")
def calibrated(trained_lot: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """URL of a registry in which the three units of the small lot are calibrated."""
    folder = tmp_path_factory.mktemp("calibrated")
    shutil.copytree(trained_lot / "lot", folder / "lot")
    shutil.copy(trained_lot / "registry.db", folder / "registry.db")
    url = f"sqlite:///{folder / 'registry.db'}"
    assert main(["batch", str(folder / "lot"), "--registry", url, "--hidden", "16,8", "--no-own"]) in (0, 1)
    return url


@pytest.fixture
def run(calibrated: str, tmp_path: Path) -> Run:
    """`run(*arguments)`: `softcal export` into tmp_path/out."""
    return lambda *arguments: main(["export", "--registry", calibrated, "--out", str(tmp_path / "out"), *arguments])


def _all_formats() -> list[str]:
    return [word for name in FORMATS for word in ("--format", name)]


def test_every_format_has_its_writer_in_order() -> None:
    assert tuple(WRITERS) == export_names.FORMATS == FORMATS


def test_every_format_is_written_and_reads_back(run: Run, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    assert run("--serial", "A1", *_all_formats(), "--check", "--json", str(report)) == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    endings = ("ssc", "json", "h", "hex", "onnx")
    assert {f"unit-A1.{end}" for end in endings} | {"certificate-A1.pdf", "certificate-A1.xml"} <= names
    assert {"softsensor.h", "manifest.json"} <= names
    assert (tmp_path / "out" / "unit-A1.ssc").stat().st_size <= 256
    content = json.loads(report.read_text())
    assert content["check"]["problems"] == []
    (unit,) = content["units"]
    assert unit["device"]["rms_error"] <= unit["device"]["limit"]


def test_a_device_form_that_is_refused_leaves_the_certificate_of_this_verdict(
    calibrated: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(calibrated.removeprefix("sqlite:///"), tmp_path / "registry.db")
    url, out = f"sqlite:///{tmp_path / 'registry.db'}", tmp_path / "out"
    with open_registry(url) as registry:
        change_limit(registry, "small", 1e-3, reason="test", actor="test")
        assert registry.lots.units("small", "A1")[0].verdict == "fail"
    export = ["export", "--registry", url, "--out", str(out), "--serial", "A1", "--format"]
    assert main([*export, "pdf"]) == 0
    certificate = (out / "certificate-A1.pdf").read_bytes()
    assert main([*export, "json"]) != 0
    assert (out / "certificate-A1.pdf").read_bytes() == certificate
    assert not (out / "unit-A1.json").exists()
    capsys.readouterr()
    assert main(["export", "--check", "--out", str(out)]) == 0, capsys.readouterr().out


@pytest.mark.long
def test_the_same_calibration_gives_the_same_bytes_in_any_folder_and_time_zone(
    run: Run, calibrated: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run("--serial", "A1", *_all_formats())
    # audit.json says where the registry's audit trail stood, which goes on with every export.
    first = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.name != AUDIT}
    other = tmp_path / "a folder of another name" / "deeper"
    monkeypatch.setenv("TZ", "Pacific/Kiritimati")
    time.tzset()
    try:
        main(["export", "--registry", calibrated, "--out", str(other), "--serial", "A1", *_all_formats()])
    finally:
        monkeypatch.undo()
        time.tzset()
    assert {path.name: path.read_bytes() for path in other.iterdir() if path.name != AUDIT} == first
    # No file names the machine it was made on.
    for path in (tmp_path / "out").iterdir():
        assert str(tmp_path).encode() not in path.read_bytes()
        assert str(Path.home()).encode() + b"/" not in path.read_bytes()


def test_onnx_agrees_with_the_float_model_and_carries_its_metadata(run: Run, calibrated: str, tmp_path: Path) -> None:
    run("--serial", "A2", "--format", "onnx")
    path = tmp_path / "out" / "unit-A2.onnx"
    session = onnxruntime.InferenceSession(path)
    with open_registry(calibrated) as registry:
        unit = UnitLoader(registry, ExportOptions()).load("A2")
    windows = unit.recording.windows
    mapped = unit.state.unit_map.apply(windows)
    estimate, source_window = session.run(["estimate", "source_window"], {"window": windows.astype(np.float32)})
    assert np.abs(estimate - unit.network.evaluate(mapped)).max() < 1e-4
    assert np.abs(source_window - mapped).max() < 1e-5
    metadata = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    assert (metadata["serial"], metadata["network_id"]) == ("A2", unit.network.id)
    assert metadata["map_sha256"] == unit.stored.state.map_sha256
    assert (metadata["window_period_ms"], metadata["window_longest_step_ms"]) == ("20.0", "30")


def _by_c(folder: Path, names: tuple[Path, Path], codes: np.ndarray) -> np.ndarray:
    """Value, lower, upper and flags of every window, by the C runtime behind examples/pc; a gap before each window."""
    program, root = folder / "pc", Path(__file__).parents[2] / "firmware"
    sources = [f"-I{root / 'softsensor'}", str(root / "examples" / "pc" / "softsensor_pc.c"), "-o", str(program)]
    subprocess.run(["gcc", "-std=c99", "-O2", *sources], check=True)
    lines = [f"{1000 * (k + 1) + 20 * i} {c}\n" for k, row in enumerate(codes) for i, c in enumerate(row)]
    process = subprocess.run([program, *names], input="".join(lines), capture_output=True, text=True, check=True)
    return np.array([line.split() for line in process.stdout.splitlines()], dtype=int)[14::15]


def _header_bytes(text: str) -> bytes:
    return b"".join(int(word, 16).to_bytes(4, "little") for word in re.findall(r"0x([0-9a-f]{8})u", text))


def _memory(text: str) -> bytes:
    """The data of an Intel HEX file at consecutive addresses."""
    raw = [bytes.fromhex(line.removeprefix(":")) for line in text.splitlines()]
    return b"".join(line[4:-1] for line in raw if line[3] == 0)


def test_all_forms_of_a_unit_agree_on_the_same_windows(
    run: Run, tmp_path: Path, rng: np.random.Generator, require_program: Callable[..., str]
) -> None:
    """ONNX, C, hex, blob, JSON and NumPy; windows of the unit's own range and far outside it."""
    run("--serial", "A2", *[word for name in ("blob", "c", "hex", "json", "onnx") for word in ("--format", name)])
    out = tmp_path / "out"
    (network_path,) = out.glob("network-*.ssc")
    network, unit = network_path.read_bytes(), (out / "unit-A2.ssc").read_bytes()
    stem = network_path.stem
    assert _header_bytes((out / "unit-A2.h").read_text()) == _memory((out / "unit-A2.hex").read_text()) == unit
    assert _header_bytes((out / f"{stem}.h").read_text()) == _memory((out / f"{stem}.hex").read_text()) == network
    assert unit_from_values(json.loads((out / "unit-A2.json").read_text())["device"]).to_bytes() == unit
    assert network_from_values(json.loads((out / f"{stem}.json").read_text())).to_bytes() == network

    sensor = open_sensor(network, unit)
    file, scale = sensor.unit_file, sensor.unit_file.scale
    count = 10.0**sensor.network_file.network.output_exponent
    span = file.code_max - file.code_min
    start = rng.uniform(file.code_min - 0.2 * span, file.code_max + 0.2 * span, (600, 1))
    codes = np.clip(np.rint(start + np.cumsum(rng.normal(0, 0.01 * span, (600, 15)), axis=1)), 0, 65_535).astype(int)
    numpy = sensor.estimate(codes)
    by_numpy = np.stack([numpy.value, numpy.lower, numpy.upper, numpy.flags], axis=1)
    assert {0, OUT_OF_RANGE} <= set(numpy.flags.tolist())

    session = onnxruntime.InferenceSession(out / "unit-A2.onnx")
    onnx_input = {"window": scale.outputs(codes).astype(np.float32)}
    names = ["estimate", "lower", "upper", "flag"]
    estimate, lower, upper, flag = session.run(names, onnx_input)
    inside = (flag == 0) & (numpy.flags == 0)
    assert inside.sum() > 200
    full_scale = count * (file.out_max - file.out_min)
    assert np.abs(estimate - count * numpy.value)[inside].max() < 0.005 * full_scale
    half_widths = count * np.stack([numpy.value - numpy.lower, numpy.upper - numpy.value], axis=1)
    assert (
        np.abs(np.stack([estimate - lower, upper - estimate], axis=1) - half_widths)[inside].max() < 0.02 * full_scale
    )
    assert np.array_equal(flag & OUT_OF_RANGE, numpy.flags & OUT_OF_RANGE)
    assert np.mean((flag & CLAMPED) == (numpy.flags & CLAMPED)) > 0.95

    require_program("gcc")
    assert np.array_equal(_by_c(tmp_path, (network_path, out / "unit-A2.ssc"), codes), by_numpy)


def test_the_json_holds_the_calibration_without_loss(run: Run, calibrated: str, tmp_path: Path) -> None:
    run("--serial", "A1", "--format", "json")
    values = json.loads((tmp_path / "out" / "unit-A1.json").read_text())["calibration"]
    with open_registry(calibrated) as registry:
        state = registry.calibrations.get("A1").state
    in_force = FittedMap(state.unit_map, state.interval, state.fit.fitted.output_limits)
    stored_fit = fit_to_json(replace(state.fit, fitted=in_force))
    for name, array in stored_fit.arrays.items():
        stored = values["arrays"][name]
        back = np.array(stored["values"], dtype=stored["dtype"]).reshape(stored["shape"])
        assert np.array_equal(back, array)
    assert values["fit"] == json.loads(json.dumps(stored_fit.content))
    assert values["state"] == json.loads(json.dumps(adjustments_to_json(state)))


def test_a_lot_shares_one_network_and_one_manifest(run: Run, tmp_path: Path) -> None:
    assert run("--lot", "small", "--format", "blob", "--format", "json", "--check") == 0
    out = tmp_path / "out"
    assert len(list(out.glob("network-*.ssc"))) == 1
    manifest = json.loads((out / "manifest.json").read_text())
    assert sorted(manifest["units"]) == ["A1", "A2", "A3"]
    assert {row["name"] for row in manifest["files"]} == {path.name for path in out.iterdir()} - {
        "manifest.json",
        AUDIT,
    }


def _keys(folder: Path, passphrase: bytes | None = None) -> tuple[str, str]:
    """A fresh Ed25519 key: its private file, encrypted where there is a passphrase, and its public one."""
    key = Ed25519PrivateKey.generate()
    encoding = serialization.Encoding.PEM
    lock = serialization.BestAvailableEncryption(passphrase) if passphrase else serialization.NoEncryption()
    (folder / "key.pem").write_bytes(key.private_bytes(encoding, serialization.PrivateFormat.PKCS8, lock))
    public = key.public_key().public_bytes(encoding, serialization.PublicFormat.SubjectPublicKeyInfo)
    (folder / "key.pub").write_bytes(public)
    return str(folder / "key.pem"), str(folder / "key.pub")


def test_check_answers_three_questions_apart(run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, (private, public) = tmp_path / "out", _keys(tmp_path)
    run("--serial", "A1", "--format", "blob", "--sign", private)

    def check(key: str | None, code: int) -> FolderCheck:
        """The answers; the command's exit code is that, and it names every problem."""
        report = check_folder(out, read_trusted_keys([Path(key)]) if key else ())
        capsys.readouterr()
        assert run("--check", *(("--public-key", key) if key else ())) == code
        error = " ".join(capsys.readouterr().err.split())
        assert all(problem.split(":")[0] in error for problem in report.problems)
        return report

    result = check(public, 0)
    assert not result.problems and result.signed_by.startswith("key (")
    assert check(None, 0).signed_by == NOT_CHECKED
    original = (out / "unit-A1.ssc").read_bytes()
    (out / "unit-A1.ssc").rename(out / "unit-A9.ssc")
    result = check(public, 2)
    assert [line.split(":")[0] for line in result.incomplete] == ["unit-A1.ssc", "unit-A9.ssc"] and not result.changed
    (out / "unit-A9.ssc").unlink()
    (out / "unit-A1.ssc").write_bytes(original[:-1] + bytes([original[-1] ^ 1]))
    result = check(public, 2)
    assert not result.incomplete and [line.split(":")[0] for line in result.changed] == ["unit-A1.ssc"]
    (out / "unit-A1.ssc").write_bytes(original)
    (tmp_path / "other").mkdir()
    other = _keys(tmp_path / "other")[1]
    result = check(other, 2)
    assert result.signed_by == INVALID and not result.incomplete and not result.changed
    manifest = (out / "manifest.json").read_text()
    (out / "manifest.json").write_text(manifest.replace('"pass"', '"fail"').replace("conditional", "pass"))
    assert check(public, 2).signed_by == INVALID
    (out / "manifest.json").write_text(manifest)
    assert run("--serial", "A2", "--format", "blob") == 0
    assert not (out / "manifest.sig").exists()
    assert check(None, 0).signed_by == NOT_SIGNED
    assert check(public, 2).signature_problem


def test_a_certificate_carries_a_signature_that_other_programs_verify(
    run: Run, tmp_path: Path, require_program: Callable[..., str]
) -> None:
    require_program("openssl")
    out, (private, public) = tmp_path / "out", _keys(tmp_path)
    formats = ["--format", "dcc", "--format", "pdf"]
    assert run("--serial", "A1", *formats, "--sign", private, "--check", "--public-key", public) == 0

    def verifies(name: str) -> bool:
        files = ["-in", str(out / name), "-sigfile", str(out / f"{name}.sig")]
        command = ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", public, "-rawin", *files]
        return subprocess.run(command, capture_output=True).returncode == 0

    assert verifies("certificate-A1.xml") and verifies("certificate-A1.pdf")
    content = (out / "certificate-A1.xml").read_bytes()
    (out / "certificate-A1.xml").write_bytes(content.replace(b"false", b"true "))
    assert not verifies("certificate-A1.xml")
    assert run("--check", "--public-key", public) == 2
    assert run("--serial", "A1", *formats) == 0
    assert not list(out.glob("*.sig"))
    assert run("--check") == 0


def test_keys_change_and_the_check_says_whose_the_signature_is(run: Run, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("old", "new", "other")]
    for folder in folders:
        folder.mkdir()
    keys = [_keys(folder) for folder in folders]
    ring = tmp_path / "ring.toml"

    def check(old_until: str, new_from: str) -> tuple[int, str]:
        ring.write_text(
            f'[[key]]\nname = "Works 2025"\nfile = "old/key.pub"\nvalid_until = {old_until}\n'
            f'[[key]]\nname = "Works 2026"\nfile = "new/key.pub"\nvalid_from = {new_from}\n'
        )
        return run("--check", "--public-key", str(ring)), check_folder(
            tmp_path / "out", read_trusted_keys([ring])
        ).signed_by

    run("--serial", "A1", "--format", "blob", "--sign", keys[1][0])
    code, answer = check("2020-01-01", "2020-01-01")
    assert code == 0 and answer.startswith("Works 2026 (")
    assert check("2020-01-01", "2099-01-01")[0] == 2  # not valid yet
    run("--serial", "A1", "--format", "blob", "--sign", keys[0][0])
    code, answer = check("2099-01-01", "2020-01-01")
    assert code == 0 and answer.startswith("Works 2025 (")
    assert check("2020-01-01", "2020-01-01")[0] == 2  # no longer valid
    run("--serial", "A1", "--format", "blob", "--sign", keys[2][0])
    assert check("2099-01-01", "2020-01-01")[0] == 2  # of nobody in the ring
    assert run("--check", "--public-key", str(ring), "--public-key", keys[2][1]) == 0


@pytest.mark.parametrize(
    "ring",
    ["", "[[key]]\n", '[[key]]\nname = "x"\nfile = "gone.pub"\n', '[[key]]\nname = "x"\nfille = "y"\n', "key = 3"],
)
def test_a_key_ring_that_is_none_is_refused(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], ring: str
) -> None:
    run("--serial", "A1", "--format", "blob")
    (tmp_path / "ring.toml").write_text(ring)
    assert run("--check", "--public-key", str(tmp_path / "ring.toml")) == 2
    printed = capsys.readouterr()
    assert "complete" not in printed.out and re.search(r"ring\.toml|gone\.pub", printed.err)


def test_a_passphrase_comes_from_a_file_or_from_a_person(tmp_path: Path) -> None:
    private, _ = _keys(tmp_path, b"open sesame")
    (tmp_path / "passphrase").write_text("open sesame\n")
    key = open_signing_key(Path(private), tmp_path / "passphrase")
    prompts: list[str] = []
    typed = open_signing_key(Path(private), None, lambda text: prompts.append(text) or "open sesame")
    assert typed.sign(b"x") == key.sign(b"x")
    assert len(prompts) == 1 and private in prompts[0]
    for wrong in ("", "open says me"):
        (tmp_path / "passphrase").write_text(wrong)
        with pytest.raises(InputError):
            open_signing_key(Path(private), tmp_path / "passphrase")


OUTSIDE = ["../victim.txt", "/etc/hostname", "..", "deep/er.ssc", "..\\victim.txt", "manifest.json", ""]


def test_a_manifest_reaches_nothing_outside_its_folder(run: Run, tmp_path: Path) -> None:
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    run("--serial", "A1", "--format", "blob", "--format", "json")
    path = tmp_path / "out" / "manifest.json"
    whole = path.read_text()
    for name in OUTSIDE:
        manifest = json.loads(whole)
        manifest["files"].append({"name": name, "sha256": "0" * 64, "size": 4, "serial": "A1"})
        path.write_text(json.dumps(manifest))
        assert run("--check") == 2, name
        assert run("--serial", "A1", "--format", "blob") == 2, name
        assert victim.read_text() == "mine"


def test_a_file_that_is_a_link_or_listed_twice_is_refused(run: Run, tmp_path: Path) -> None:
    run("--serial", "A1", "--format", "blob")
    unit, path = tmp_path / "out" / "unit-A1.ssc", tmp_path / "out" / "manifest.json"
    unit.rename(tmp_path / "elsewhere.ssc")
    unit.symlink_to(tmp_path / "elsewhere.ssc")
    assert run("--check") == 2
    unit.unlink()
    (tmp_path / "elsewhere.ssc").rename(unit)
    assert run("--check") == 0
    manifest = json.loads(path.read_text())
    manifest["files"].append(manifest["files"][0])
    path.write_text(json.dumps(manifest))
    assert run("--check") == 2


def test_a_key_that_cannot_sign_is_refused_before_anything_is_written(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SOFTCAL_SIGNING_PASSPHRASE", raising=False)
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    rsa_key = rsa.generate_private_key(65_537, 2048)
    (tmp_path / "rsa.pem").write_bytes(rsa_key.private_bytes(encoding, form, serialization.NoEncryption()))
    private, public = _keys(tmp_path, b"open sesame")
    for key, text in ((str(tmp_path / "rsa.pem"), "Ed25519"), (private, "SOFTCAL_SIGNING_PASSPHRASE")):
        assert run("--serial", "A1", "--format", "blob", "--sign", key) == 2
        assert text in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
    monkeypatch.setenv("SOFTCAL_SIGNING_PASSPHRASE", "wrong")
    assert run("--serial", "A1", "--format", "blob", "--sign", private) == 2
    assert not (tmp_path / "out").exists()
    monkeypatch.setenv("SOFTCAL_SIGNING_PASSPHRASE", "open sesame")
    assert run("--serial", "A1", "--format", "blob", "--sign", private, "--check", "--public-key", public) == 0


def _with_verdict(calibrated: str, folder: Path, verdict: str) -> str:
    """A copy of the registry in which A1's newest calibration, which no audit measured, has another verdict."""
    copy = folder / "failed.db"
    shutil.copy(calibrated.removeprefix("sqlite:///"), copy)
    with open_registry(f"sqlite:///{copy}") as registry:
        stored = registry.calibrations.get("A1")
        bent = Finding(plain("bent in the press"), Verdict(verdict))
        fit = replace(stored.state.fit, findings=(bent,))
        registry.calibrations.add(stored.lot_id, replace(stored.state, fit=fit, audit=None), reason="test")
    return f"sqlite:///{copy}"


def test_a_unit_that_failed_gets_no_file_that_gives_numbers(
    calibrated: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, url = tmp_path / "out", _with_verdict(calibrated, tmp_path, "fail")
    arguments = ["export", "--registry", url, "--out", str(out), "--serial", "A1"]
    assert main([*arguments, "--revision", "1", "--format", "blob", "--format", "c"]) == 0
    assert main([*arguments, *_all_formats()]) == 2
    assert "bent in the press" in capsys.readouterr().err
    names = {path.name for path in out.iterdir() if "A1" in path.name}
    assert names == {"certificate-A1.pdf", "certificate-A1.xml"}  # the older blob is gone as well
    assert main([*arguments, "--format", "blob", "--failed-too", "--check"]) == 0
    assert (out / "unit-A1.ssc").read_bytes()[7] == 2


@pytest.mark.parametrize("verdict", ["conditional", "fail", "retest"])
def test_the_verdict_alone_releases_a_file_of_any_format(calibrated: str, tmp_path: Path, verdict: str) -> None:
    url, out = _with_verdict(calibrated, tmp_path, verdict), tmp_path / "out"
    formats = sorted({*FORMATS} - {"pdf", "dcc"})
    for name in formats:
        arguments = ["export", "--registry", url, "--out", str(out / name), "--serial", "A1", "--format", name]
        assert main(arguments) == 2
        assert not list(out.glob("*/*A1*"))
    for name in formats:
        arguments = ["export", "--registry", url, "--out", str(out / name), "--serial", "A1", "--format", name]
        assert main([*arguments, "--release", "conditional"]) == (0 if verdict == "conditional" else 2)
        assert bool(list((out / name).glob("unit-A1.*"))) == (verdict == "conditional")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--serial", "NOBODY", "--format", "blob"], "NOBODY"),
        (["--serial", "A1", "--serial", "NOBODY"], "NOBODY"),
        (["--serial", "A1", "--serial", "A1"], "A1"),
        (["--serial", "A1", "--serial", "a1"], "a1"),
        (["--lot", "other"], "other"),
        (["--serial", "A1", "--revision", "7"], "revision 7"),
        (["--serial", "A1", "--format", "blob", "--adc-bits", "10"], "full scale"),
        (["--serial", "A1", "--format", "blob", "--adc-bits", "40", "--adc-full-scale", "5"], " 16 "),
        (["--serial", "A1", "--format", "blob", "--adc-bits", "10", "--adc-full-scale", "0.1"], "full scale"),
        (["--serial", "A1", "--format", "hex", "--unit-address", "3"], " 4"),
        (["--serial", "A1", "--max-deviation", "7"], "max-deviation"),
        (["--serial", "A1", "--format", "pdf", "--laboratory", "nowhere.toml"], "nowhere.toml"),
        (["--serial", "A1", "--sign", "nowhere.pem"], "nowhere.pem"),
        (["--check"], "manifest.json"),
        ([], "--format"),
    ],
)
def test_wrong_use_ends_in_one_line_and_exit_code_2(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert run(*arguments) == 2
    last_line = capsys.readouterr().err.strip().splitlines()[-1]
    assert message in last_line
    assert not list((tmp_path / "out").glob("*.ssc"))


def test_a_folder_that_holds_something_else_is_left_alone(run: Run, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "manifest.json").write_text('{"schema": "of somebody else"}')
    assert run("--serial", "A1") == 2
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["manifest.json"]


def test_the_use_case_returns_what_it_wrote(calibrated: str, tmp_path: Path) -> None:
    exported = []
    with open_registry(calibrated) as registry:
        results = export_units(registry, ["A1", "A2"], ("blob",), tmp_path, on_unit=exported.append)
        with pytest.raises(InputError, match="png"):
            export_units(registry, ["A1"], ("png",), tmp_path)
    assert [unit.serial for unit in results] == ["A1", "A2"] == [unit.serial for unit in exported]
    assert results[0].files[0] == "unit-A1.ssc"


def test_inspect_shows_a_file_and_runs_its_self_tests(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("--serial", "A1", "--format", "blob", "--format", "json")
    out = tmp_path / "out"
    (network,) = out.glob("network-*.ssc")
    capsys.readouterr()
    assert main(["inspect", str(out / "unit-A1.ssc"), "--network", str(network)]) == 0
    assert "4 of 4" in capsys.readouterr().out
    assert main(["inspect", str(network)]) == 0
    assert "15-16-8-1" in capsys.readouterr().out
    assert main(["inspect", str(out / "unit-A1.ssc"), "--json", "-"]) == 0
    blob = json.loads(capsys.readouterr().out)
    assert main(["inspect", str(out / "unit-A1.json"), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == blob


@pytest.mark.parametrize("stem", ["unit-A1", "network"])
def test_a_json_twin_is_shown_as_proven_only_while_it_is_what_was_exported(run, tmp_path, capsys, stem):
    run("--serial", "A1", "--format", "json")
    (file,) = (tmp_path / "out").glob(f"{stem}*.json")
    capsys.readouterr()
    values = json.loads(file.read_text())
    assert main(["inspect", str(file)]) == 0
    assert "not proven" not in capsys.readouterr().out
    bare = tmp_path / "bare.json"
    bare.write_text(json.dumps({name: value for name, value in values.items() if name != "sha256"}))
    assert main(["inspect", str(bare)]) == 0
    printed = capsys.readouterr().out
    assert "not proven" in printed and "passed" not in printed
    # Every number, text and flag of it counts.
    for path in sorted(leaves(values), key=str)[:: max(1, len(leaves(values)) // 40)]:
        edited = json.loads(file.read_text())
        checked_path = edited
        for part in path[:-1]:
            checked_path = checked_path[part]
        old = checked_path[path[-1]]
        checked_path[path[-1]] = (old + 1) if isinstance(old, int | float) else f"{old}x"
        bare.write_text(json.dumps(edited))
        assert main(["inspect", str(bare)]) == 2, path
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


def leaves(value: object, path: tuple = ()) -> list[tuple]:
    """Where the single values of a JSON value stand."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return [leaf for key, item in items for leaf in leaves(item, (*path, key))]
    return [path]


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000, "[" * 5000 + "]" * 5000])
def test_json_that_is_nested_without_end_is_bad_input(tmp_path, capsys, content):
    (tmp_path / "deep.json").write_text(content)
    assert main(["inspect", str(tmp_path / "deep.json")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "deep.json" in line and "defect" not in line


def test_inspect_refuses_what_is_no_calibration_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for content in (b"", b"hello", b"[]", b"{}", b"SSCF", bytes(300)):
        (tmp_path / "junk.ssc").write_bytes(content)
        assert main(["inspect", str(tmp_path / "junk.ssc")]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
