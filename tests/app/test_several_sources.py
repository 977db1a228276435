"""Several labelled units as sources of one lot: each unit is calibrated by the nearest, and everything says which."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softcal.app.cli.main import main
from softcal.db.connection import open_registry

SMALL = ["--hidden", "16,8", "--no-own"]


def bent(load_N: np.ndarray, curvature: float) -> np.ndarray:
    """Return the output under a load: a straight sensor at 0, one that answers late and then steeply above."""
    level = load_N / 3.0
    return 0.5 + 0.4 * ((1 - curvature) * level + curvature * level**3)


def press(seed: int, curvature: float, gain: float = 1.0) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    parts = []
    for peak in rng.uniform(1.0, 3.0, 60):
        up, down = rng.integers(10, 30, 2)
        parts += [np.linspace(0, peak, up), np.linspace(peak, 0, down), np.zeros(5)]
    load_N = np.concatenate(parts)
    output = 0.05 + gain * bent(load_N, curvature) + rng.normal(0, 0.0005, len(load_N))
    return pd.DataFrame({"t_s": np.arange(len(load_N)) / 50.0, "output": output, "reference": load_N})


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    """Two sources, straight and bent, and a unit of either kind."""
    presses = {"S1": (1, 0.0), "S2": (2, 0.6), "STRAIGHT": (3, 0.0, 1.2), "BENT": (4, 0.6, 1.2)}
    for name, how in presses.items():
        press(*how).to_csv(tmp_path / f"{name}.csv", index=False)
    return tmp_path


def imported(tables: Path, *sources: str) -> int:
    files = [str(tables / f"{name}.csv") for name in ("S1", "S2", "STRAIGHT", "BENT")]
    options = [word for serial in sources for word in ("--source", serial)]
    columns = ["--output-column", "output", "--reference-column", "reference", "--sample-rate", "50"]
    return main(["import", *files, *options, *columns, "--out", str(tables / "lot")])


@pytest.mark.long
def test_each_unit_takes_the_source_that_is_bent_like_it(tables, registry_url):
    assert imported(tables, "S1", "S2") == 0
    report = tables / "report.json"
    main(["batch", str(tables / "lot"), "--registry", registry_url, "--json", str(report), *SMALL])
    assert {unit["serial"] for unit in json.loads(report.read_text())["units"]} == {"STRAIGHT", "BENT"}
    with open_registry(registry_url) as registry:
        networks = {serial: registry.calibrations.get(serial).state.fit.network_id for serial in ("STRAIGHT", "BENT")}
        trained = {
            entry.id: entry.training["source_recording_sha256"]
            for entry in map(registry.networks.entry, networks.values())
        }
        sources = {serial: registry.recordings.get(trained[id_]).serial for serial, id_ in networks.items()}
    assert sources == {"STRAIGHT": "S1", "BENT": "S2"}


@pytest.mark.long
def test_a_second_batch_computes_nothing_and_another_set_of_sources_is_another_calibration(tables, registry_url):
    imported(tables, "S1", "S2")
    report, command = tables / "report.json", ["batch", str(tables / "lot"), "--registry", registry_url, *SMALL]

    def is_new() -> list[bool]:
        main([*command, "--json", str(report)])
        return [unit["is_new"] for unit in json.loads(report.read_text())["units"]]

    assert is_new() == [True, True]
    assert is_new() == [False, False]
    toml = tables / "lot" / "lot.toml"
    toml.write_text(toml.read_text().replace('more_sources = ["S2"]\n', ""))
    assert is_new() == [True, True]


@pytest.mark.long
def test_the_nearest_source_reads_its_unit_better_than_the_other(tables, registry_url):
    def error(lot_sources: tuple[str, ...], url: str) -> float:
        if (tables / "lot").exists():
            (tables / "lot").rename(tables / f"lot-{len(list(tables.iterdir()))}")
        imported(tables, *lot_sources)
        main(["batch", str(tables / "lot"), "--registry", url, *SMALL])
        out = tables / "out.csv"
        test = press(9, 0.6, 1.2)
        test[["t_s", "output"]].to_csv(tables / "in.csv", index=False)
        main(["estimate", "--registry", url, "--serial", "BENT", str(tables / "in.csv"), "--out", str(out)])
        return float(np.sqrt(np.nanmean((pd.read_csv(out)["estimate"] - test["reference"]) ** 2)))

    several = error(("S1", "S2"), registry_url)
    assert several < 0.5 * error(("S1",), f"sqlite:///{tables / 'one.db'}")


@pytest.mark.parametrize("second", ["S1", "NOBODY"])
def test_sources_that_cannot_be_are_one_line(tables, capsys, second):
    assert imported(tables, "S1", second) == 2
    error = capsys.readouterr().err
    assert second in error and error.count("\n") == 1 and not (tables / "lot").exists()


@pytest.mark.parametrize("more", ['["S1"]', '"S2"', '["S2", "S2"]', '["GONE"]'])
def test_a_lot_file_that_names_wrong_sources_is_one_line(tables, registry_url, capsys, more):
    imported(tables, "S1", "S2")
    toml = tables / "lot" / "lot.toml"
    toml.write_text(toml.read_text().replace('["S2"]', more))
    capsys.readouterr()
    assert main(["batch", str(tables / "lot"), "--registry", registry_url, *SMALL]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and ("more_sources" in error or "GONE" in error)
