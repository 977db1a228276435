"""What a lot's source was compared with, from lot.toml, station and registry into the verdict of every unit."""

from dataclasses import fields, replace
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.app.files.lot_folder import open_lot_folder
from softcal.app.line.pressed_run import RunStore
from softcal.app.line.rig import station_reference
from softcal.app.registry.reference import declare_reference, lot_reference, reference_expanded
from softcal.core.network.config import NetworkConfig
from softcal.core.orders import Order, OrderKind
from softcal.core.unit.budget import SIMULATED, Reference, Traceability
from softcal.db.connection import open_registry
from softcal.db.entries import CellCertificate
from softcal.station.devices.config import ForceConfig, ReadoutConfig, StageConfig, StationConfig
from softcal.station.record.recording import Alignment, StationRecording

CELL = CellCertificate("LC-7", "D-K-1", "DAkkS", date(2026, 1, 1), date(2028, 1, 1), 10.0, 0.012)
REFERENCE_TOML = '[reference]\nunit = "N"\ncell = "LC-7"\nused_on = {used_on}\n'


def restated(folder: Path, reference: str) -> None:
    """Write the small lot's facts with another reference."""
    top = 'sample_rate_Hz = 50.0\nsource = "A0"\n[lot]\nid = "small"\n'
    limit = "" if "[limit]" in reference else "[limit]\nrmse = 0.16\n"
    (folder / "lot.toml").write_text(f'{top}{reference}[output]\nunit = "V"\n{limit}')


def calibrate_lot(folder: Path, url: str) -> tuple[set[str], str]:
    """Calibrate the lot; the verdicts of its units, and the code of the first reason of A1."""
    main(["batch", str(folder), "--registry", url, "--hidden", "16,8", "--no-own"])
    with open_registry(url) as registry:
        units = {unit.serial: unit for unit in registry.lots.units("small") if unit.role == "target"}
    return {unit.verdict for unit in units.values()}, units["A1"].reasons[0].code


def test_a_reference_without_a_certificate_that_held_lets_no_unit_pass(lot_folder: Path, registry_url: str) -> None:
    assert calibrate_lot(lot_folder, registry_url)[0] == {"pass"}
    restated(lot_folder, REFERENCE_TOML.format(used_on="2026-06-01"))
    assert calibrate_lot(lot_folder, registry_url) == ({"conditional"}, "reference_missing")
    with open_registry(registry_url) as registry:
        registry.stations.add_certificate(CELL)
    assert calibrate_lot(lot_folder, registry_url)[0] == {"pass"}
    restated(lot_folder, REFERENCE_TOML.format(used_on="2028-06-01"))
    assert calibrate_lot(lot_folder, registry_url) == ({"conditional"}, "reference_expired")
    rough = 'certificate = "D-K-2"\ndue_on = 2028-01-01\nuncertainty = 5\n'
    restated(lot_folder, REFERENCE_TOML.format(used_on="2026-06-01") + rough)
    assert calibrate_lot(lot_folder, registry_url) == ({"conditional"}, "reference_uncertain")
    with open_registry(registry_url) as registry:
        fit = registry.calibrations.get("A1").state.fit
        assert fit.reference == lot_reference(registry, "small")
        assert len(registry.trail.of_kind("lot_references")) == 5


def test_what_is_stated_is_kept_and_completed_from_the_registry(lot_folder: Path, registry_url: str) -> None:
    recording = open_lot_folder(lot_folder).read_source()
    with open_registry(registry_url) as registry:
        assert lot_reference(registry, "small") == SIMULATED == declare_reference(registry, "small", None, recording)
        assert reference_expanded(registry, "small") == 0.0
        reference = declare_reference(registry, "small", Reference(cell="LC-7"), recording)
        (source,) = registry.recordings.of_lot("small", kind="source")
        assert reference is not None and reference.traceability is Traceability.MISSING
        assert reference.used_on == source.added_at.date()
        registry.stations.add_certificate(replace(CELL, issued_on=date(2020, 1, 1), due_on=date(2021, 1, 1)))
        late = declare_reference(registry, "small", Reference(cell="LC-7"), recording)
        assert late is not None and late.traceability is Traceability.EXPIRED
        declare_reference(registry, "small", Reference(cell="LC-7"), recording)
        load = float(np.sqrt(np.mean(recording.reference**2)))
        assert reference_expanded(registry, "small") == pytest.approx(late.expanded(load))
        assert len(registry.trail.of_kind("lot_references")) == 3
        assert lot_reference(registry, "small") == late


def test_a_source_pressed_on_a_station_is_traced_to_its_load_cell(lot_folder: Path, tmp_path: Path) -> None:
    table = pd.read_csv(lot_folder / "source" / "A0.csv")
    t_s, output, force_N = (table[name].to_numpy() for name in ("t_s", "output", "reference"))
    aligned = Alignment(*[0.0] * len(fields(Alignment)))
    run = StationRecording(
        "A0", "source", t_s, output[:, None], np.abs(np.sin(t_s)), force_N, 50.0, "V", 0.0, 0.0, 0.0, 0, aligned
    )
    with open_registry(f"sqlite:///{tmp_path / 'line.db'}") as registry:
        registry.stations.add_certificate(replace(CELL, due_on=date(2099, 1, 1)))
        small = NetworkConfig(hidden=(4,), max_epochs=2)
        run_store = RunStore(registry, "s1", small, reference=Reference(cell="LC-7"))
        run_store.store(Order("o1", "s1", OrderKind.SOURCE, "A0", "L1"), run, lambda progress: None)
        reference = lot_reference(registry, "L1")
    assert reference is not None and (reference.traceability, reference.certificate, reference.capacity) == (
        Traceability.VALID,
        "D-K-1",
        10.0,
    )
    assert reference.used_on == datetime.now(UTC).date()


@pytest.mark.parametrize("is_named", [True, False])
def test_a_station_says_what_its_sources_are_compared_with(is_named: bool) -> None:
    config = StationConfig(StageConfig(""), ReadoutConfig(""), ForceConfig("", serial="LC-7" if is_named else ""))
    reference = station_reference(config)
    assert reference is not None and reference.traceability is Traceability.MISSING
    assert (reference.cell == "LC-7") == is_named
    assert station_reference(replace(config, force=None)) is None


@pytest.mark.long
def test_paper_vouches_for_nothing_that_the_lot_does_not(lot_folder: Path, tmp_path: Path) -> None:
    """A lot without a reference passes against its own labels; no certificate of it says so, whoever names a cell."""
    laboratory = tmp_path / "laboratory.toml"
    laboratory.write_text('[load_cell]\ncertificate = "D-K-1"\nuncertainty_N = 5\n')
    url = f"sqlite:///{tmp_path / 'other.db'}"

    def certificates(reference: str) -> tuple[int, str]:
        restated(lot_folder, f"{reference}[limit]\nrmse = 0.5\n")
        assert calibrate_lot(lot_folder, url)[0] == {"pass"}
        out = ["--format", "dcc", "--laboratory", str(laboratory), "--out", str(tmp_path / "out")]
        code = main(["export", "--registry", url, "--serial", "A1", *out])
        return code, (tmp_path / "out" / "certificate-A1.xml").read_text()

    code, text = certificates('[reference]\nunit = "N"\n')
    assert code == 0 and "<dcc:traceable>false" in text and "<dcc:conformity>" not in text
    toml_text = REFERENCE_TOML.format(used_on="2026-06-01") + "due_on = 2028-01-01\nuncertainty = 0.012\n"
    code, text = certificates(toml_text + 'certificate = "D-K-1"\n')
    assert code == 0 and "<dcc:traceable>true" in text and "<dcc:conformity>pass" in text
    assert certificates(toml_text + 'certificate = "D-K-2"\n')[0] == 2
