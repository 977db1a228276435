"""`softcal demo`: the main job on a simulated station."""

import argparse
import time
from pathlib import Path

from softcal.app.cli.options import COUNT, DIR, FILE, add_network, add_shared, network_config, registry_at
from softcal.app.output import ProgressBar, print_table, write_json

EXAMPLES = """examples:
  softcal demo
  softcal demo --units 3 --out somewhere --json -
  softcal demo --twin rig-7.twin.json         units like the twin that explains a rig
then look around:
  softcal registry list --registry sqlite:///softcal-demo/registry.db
  softcal ui --registry sqlite:///softcal-demo/registry.db
"""


CALIBRATED = 0.95
"""Share of the bar until every unit is calibrated; the registry, the audits and the files have the rest."""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Press a simulated lot; stage, load cell and sensor use their real serial protocols.

    Train the shared network on the source and fit every unit's map without labels. Decide, register, export, and print
    a table like the paper's Table 1.
    """
    parser.add_argument("--out", default=Path("softcal-demo"), **DIR, help="default: softcal-demo")
    parser.add_argument("--units", default=6, **COUNT, help="target units (default 6)")
    parser.add_argument("--twin", **FILE, help="units like this twin (softcal gap apply)")
    parser.add_argument("--jobs", default=2, **COUNT, help="worker processes (default 2)")
    add_network(parser)
    add_shared(parser, "json", "csv")


def run(options: argparse.Namespace) -> int:
    """Run the demo and print its table."""
    progress = ProgressBar("loading")
    from softcal.app.batch.batch import run_batch
    from softcal.app.batch.engine import EngineChoice
    from softcal.app.batch.lot_work import BatchConfig
    from softcal.app.batch.report import report_json
    from softcal.app.export.export import export_units
    from softcal.app.gap.diagnose import read_twin
    from softcal.app.jobs.jobs import PRESSING, lot_callbacks
    from softcal.app.line.demo import TABLE_HEADER, DemoConfig, press_demo_lot, table_row

    start_s = time.monotonic()
    batch = BatchConfig(network=network_config(options), engine=EngineChoice("local", options.jobs), chunk=1)
    twin = read_twin(options.twin) if options.twin else None
    config = DemoConfig(units=options.units, batch=batch, twin=twin)
    note = "pressing the source and the units over their serial lines"

    def on_run(sentence: str) -> None:
        nonlocal note
        note = sentence

    folder = press_demo_lot(
        config, options.out / "lot", on_run, lambda share: progress.show_progress(CALIBRATED * PRESSING * share, note)
    )
    url = f"sqlite:///{options.out / 'registry.db'}"
    with registry_at(url) as registry:
        report = run_batch(folder, registry, config.batch, lot_callbacks(_Steps(progress), PRESSING))
        passed = [unit.serial for unit in report.units if report.releases(unit)]
        export_units(registry, passed, ("json",), options.out / "files")
    progress.show_progress(1.0, "done")
    print_table(TABLE_HEADER, [table_row(unit) for unit in report.units])
    fits_s = [unit.state.fit.fit_s for unit in report.units if unit.state and unit.state.fit.fit_s]
    train_s = report.network.metrics["train_s"]
    print(f"\ntraining f took {train_s:.1f} s, a map {sorted(fits_s)[len(fits_s) // 2]:.3f} s (median)")
    print(f"all in all {time.monotonic() - start_s:.0f} s; registry, recordings and files are in {options.out}/")
    print(f"the lot's page is {report.lot_id!r} on the desk: softcal ui --registry {url}")
    write_json(options.json, report_json(report))
    return 0 if report.has_passed else 1


class _Steps:
    """Steps of a calibration as notes of a bar."""

    def __init__(self, progress: ProgressBar) -> None:
        self._progress = progress

    def step(self, fraction: float, name: str, **values: object) -> None:
        self._progress.show_progress(CALIBRATED * fraction, f"{name} {' of '.join(map(str, values.values()))}")
