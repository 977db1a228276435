"""A lot with several labelled units: what their networks read of one load says which of them is a bad source."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.calibration.lot_decision import decision_in_force
from softcal.app.cli.main import main
from softcal.db.connection import open_registry
from tests.presses import dwelling_presses

UNITS = [f"U{k}" for k in range(1, 6)]
LOW = 0.7
"""Reading over load of the cell under the last source."""


def recorded(force_N: np.ndarray, seed: int, reading: float = 1.0) -> pd.DataFrame:
    unit_rng = np.random.default_rng([seed, 7])
    gain, curvature = unit_rng.uniform(0.8, 1.2), unit_rng.uniform(0.0, 0.02)
    noise = np.random.default_rng([seed, len(force_N)]).normal(0, 0.0005, len(force_N))
    output = 0.5 + gain * (0.1 * force_N + curvature * force_N**2) + noise
    return pd.DataFrame({"t_s": np.arange(len(output)) / 50.0, "output": output, "reference": reading * force_N})


@pytest.fixture(scope="module")
def lot_of_sources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sources and five units that were pressed together; no limit is stated."""
    root = tmp_path_factory.mktemp("sources")
    folder = root / "lot"
    for name in ("source", "units"):
        (folder / name).mkdir(parents=True)
    (folder / "lot.toml").write_text(
        'sample_rate_Hz = 50.0\nsource = "S1"\n[lot]\nid = "tuesday"\nmore_sources = ["S2", "S3"]\n[reference]\n'
        'unit = "N"\n[output]\nunit = "V"\n'
    )
    for k, reading in ((1, 1.0), (2, 1.0), (3, LOW)):
        recorded(dwelling_presses(k, 3000, 2.0), 20 + k, reading).to_csv(folder / f"source/S{k}.csv", index=False)
    for serial in UNITS:
        table = recorded(dwelling_presses(9, 2000, 60.0), int(serial[1:]))
        table[["t_s", "output"]].to_csv(folder / f"units/{serial}.csv", index=False)
    main(["batch", str(folder), "--registry", f"sqlite:///{root / 'r.db'}", "--hidden", "16,8", "--no-own",
          "--json", str(root / "b.json")])  # fmt: skip
    return root


@pytest.mark.long
def test_the_bad_source_is_reported_after_the_first_lot(lot_of_sources, capsys):
    report = json.loads((lot_of_sources / "b.json").read_text())
    (source_report,) = report["lot_fit"]["sources"]
    assert (
        source_report.startswith("source S3: its network reads this lot")
        and "below" in source_report
        and "(sources: 2)" in source_report
    )
    with open_registry(f"sqlite:///{lot_of_sources / 'r.db'}") as registry:
        (why,) = decision_in_force(registry, "tuesday").fit.sources
        assert why.code == "lot_fit.source.low" and why.values["serial"] == "S3"
    assert main(["lot", "fit", "tuesday", "--registry", f"sqlite:///{lot_of_sources / 'r.db'}"]) == 0
    assert "source S3: its network reads" in " ".join(capsys.readouterr().out.split())


@pytest.mark.long
def test_the_bad_source_stands_on_the_page_of_the_lot(lot_of_sources, open_page):
    def page() -> None:
        from softcal.app.ui.tabs.lot_overview import draw_overview

        draw_overview("tuesday")

    screen = open_page(f"sqlite:///{lot_of_sources / 'r.db'}", page)
    assert any("source S3: its network reads this lot" in one.value for one in screen.warning)


@pytest.mark.long
def test_all_units_show_the_load_and_each_is_mapped_by_its_own_network(lot_of_sources):
    with open_registry(f"sqlite:///{lot_of_sources / 'r.db'}") as registry:
        states = {serial: registry.calibrations.get(serial, lot_id="tuesday").state for serial in UNITS}
        sources = registry.recordings.of_lot("tuesday", kind="source")
        low = {one.id for one in registry.networks.all() if one.training["source_recording_sha256"] == next(
            entry.sha256 for entry in sources if entry.serial == "S3")}  # fmt: skip
    parts = {serial: state.fit.lot_fit for serial, state in states.items()}
    assert all(part is not None and part.units == 5 for part in parts.values())
    assert len({part.sitting for part in parts.values()}) == 1
    # What the bad source reads apart is uncertainty of the units that it reads.
    wide = {serial for serial, part in parts.items() if part.common_rmse > 0.15}
    assert wide == {serial for serial, state in states.items() if state.fit.network_id in low}


@pytest.mark.long
def test_the_limit_of_a_lot_is_that_of_its_first_source_before_and_after_the_fit(lot_of_sources):
    with open_registry(f"sqlite:///{lot_of_sources / 'r.db'}") as registry:
        limits = {
            registry.calibrations.get(serial, revision, lot_id="tuesday").state.limit.maximum_rmse
            for serial in UNITS
            for revision in (1, None)
        }
    assert len(limits) == 1
