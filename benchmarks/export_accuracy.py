"""What smaller networks and integers cost in accuracy on real lots.

    python benchmarks/export_accuracy.py [--quick]
    python benchmarks/export_accuracy.py --sizes [--demo softcal-demo/registry.db]

Source and targets of egain_pair and insole_lot: f trained on the source's first three quarters, maps fitted to each
target's first three quarters without labels, errors on the last quarter by time, in mN or mbar. `device` is the unit
file's integers, compared with the float model on rows the device does not flag; `ONNX` is the largest difference of
onnxruntime from the float model on the same windows. `--sizes` prints instead what a unit file of 256, 512 or 1024
bytes changes on every taxel, and on the units of a `softcal demo`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime
import pandas as pd
from common.command import parser_of
from common.map_methods import egain, insole, taxels
from common.tables import print_table

from softcal.app.export.calibrated_unit import ExportOptions, UnitLoader
from softcal.app.files.onnx_file import onnx_bytes
from softcal.core.errors import UnitRefused
from softcal.core.export.blob import UNIT_BYTES, NetworkFile
from softcal.core.export.compile_map import compile_map, fine_forms
from softcal.core.export.device import DeviceOptions, DeviceRecord, build_network_file, build_unit_file, limits_of_unit
from softcal.core.export.graph import compose
from softcal.core.maps.choose import choose_map
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import FitProblem
from softcal.core.metrics import rmse
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.db.connection import open_registry
from tests.device_sensor import estimate_output, open_sensor

HIDDEN = ((120, 70, 35), (48, 24), (32, 16), (16, 8), (8, 8))
TEST_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class LotData:
    """One source and its targets."""

    name: str
    unit: str
    source: LabelledRecording
    targets: list[LabelledRecording]


@dataclass(frozen=True)
class UnitRow:
    """Errors of one target on its last quarter."""

    float_rmse: float
    device_rmse: float
    device_q99: float
    flagged_pct: float
    onnx_max: float
    unit_bytes: int


def lots(quick: bool, every: int = 4) -> Iterator[LotData]:
    """The pair in one direction, and one insole with every n-th taxel as a target."""
    pair = [egain(name) for name in ("S1", "S2")]
    yield LotData("egain_pair", "mN", pair[0], [pair[1]])
    table = insole("calibration")
    names = taxels(table)[:: 20 if quick else every]
    # Every fourth sample keeps a run short; 12.2 Hz, as if recorded at that rate.
    table = table.iloc[::4]
    recordings = [_taxel(table, name) for name in names]
    yield LotData("insole_lot", "mbar", recordings[0], recordings[1:])


def _taxel(table: pd.DataFrame, name: str) -> LabelledRecording:
    t_s = table["t_s"].to_numpy(dtype=float)
    rate_Hz = 1 / float(np.median(np.diff(t_s)))
    output = table[name].to_numpy(dtype=float)
    unlabelled = OutputRecording(name, t_s, output, rate_Hz, "counts")
    return LabelledRecording(unlabelled, table["pressure_bar"].to_numpy(dtype=float), "bar")


def _split(recording: LabelledRecording) -> tuple[LabelledRecording, LabelledRecording]:
    at = round(len(recording) * (1 - TEST_SHARE))
    return recording.part(0, at), recording.part(at, len(recording))


def make_record(network: Network, source: LabelledRecording, unit: LabelledRecording, forecast: float) -> DeviceRecord:
    """Fit a map to a unit and return what an export of it takes."""
    chosen = choose_map(FitProblem(source, network, unit.unlabelled)).unit_map
    exact = network.evaluate(chosen.apply(unit.windows))
    return DeviceRecord(unit.serial, 1, "pass", 0, chosen, unit.unlabelled, exact - 0.1, exact + 0.1, forecast)


def measure(network: Network, source: LabelledRecording, target: LabelledRecording, forecast: float) -> UnitRow:
    """Fit, export and score one target; its error is forecast as the source's own."""
    train, test = _split(target)
    record = make_record(network, source, train, forecast)
    chosen = record.unit_map
    network_file = build_network_file(network, source, AnchorConfig())
    unit = build_unit_file(record, network, network_file).file
    estimate, _, _, flags = estimate_output(open_sensor(network_file.to_bytes(), unit.to_bytes()), test.windows)
    truth = network.evaluate(chosen.apply(test.windows))
    compiled = compile_map(chosen, network, train.unlabelled, np.inf, fine_forms)
    limits = limits_of_unit(record, network, DeviceOptions())
    session = onnxruntime.InferenceSession(onnx_bytes(compose(compiled.form, network, limits), {}))
    onnx_estimate = session.run(["estimate"], {"window": test.windows.astype(np.float32)})[0]
    same_form = np.clip(network.evaluate(compiled.form.apply(test.windows)), limits.estimate_low, limits.estimate_high)
    return UnitRow(
        1000 * rmse(truth, test.window_reference),
        1000 * rmse(estimate, test.window_reference),
        1000 * float(np.quantile(np.abs(estimate - truth)[flags == 0], 0.99)),
        100 * float(np.mean(flags != 0)),
        1000 * float(np.abs(onnx_estimate - same_form).max()),
        len(unit.to_bytes()),
    )


def row(lot: LotData, hidden: tuple[int, ...], epochs: int) -> list[str]:
    """Train one network of a lot and measure every target."""
    train, test = _split(lot.source)
    network = fit_network(train, NetworkConfig(hidden=hidden, max_epochs=epochs)).network
    unit_rmse = 1000 * rmse(network.evaluate(test.windows), test.window_reference)
    values, refused = [], 0
    for target in lot.targets:
        try:
            values.append(measure(network, train, target, unit_rmse / 1000))
        except UnitRefused as error:
            refused += 1
            print(f"refused: {error}")
    columns = [np.array([getattr(unit, name) for unit in values]) for name in UnitRow.__dataclass_fields__]
    medians = [float(np.median(column)) for column in columns[:2]]
    return [
        lot.name, "-".join(map(str, network.sizes)), f"{unit_rmse:.1f} {lot.unit}", f"{medians[0]:.1f}",
        f"{medians[1]:.1f}",
        f"{100 * (medians[1] / medians[0] - 1):+.2f}", f"{columns[2].max():.2f}",
        f"{columns[3].max():.1f}", f"{columns[4].max():.1e}",
        f"{columns[5].max()}", f"{len(values)} ({refused})",
    ]  # fmt: skip


def by_size(lot: str, record: DeviceRecord, network: Network, network_file: NetworkFile, unit: str) -> list[str]:
    """Largest and rms change of the estimate by files of each size, and the size an export takes by itself."""
    cells, smallest = [], None
    for size in UNIT_BYTES:
        try:
            device = build_unit_file(record, network, network_file, DeviceOptions(unit_bytes=size))
        except UnitRefused:
            cells.append("refused")
            continue
        cells.append(f"{1000 * device.max_error:.1f} ({1000 * device.rms_error:.1f})")
        if smallest is None and device.max_error <= device.goal:
            smallest = f"{len(device.file.to_bytes())} B"
    span = float(np.ptp(network.evaluate(record.unit_map.apply(record.recording.windows))))
    return [lot, record.serial, f"{1000 * span:.0f} {unit}", *cells, smallest or "the nearest"]


def lot_sizes(lot: LotData, epochs: int) -> Iterator[list[str]]:
    """Every target of a lot behind one small network."""
    train, test = _split(lot.source)
    network = fit_network(train, NetworkConfig(hidden=(32, 16), max_epochs=epochs)).network
    unit_rmse, network_file = (
        rmse(network.evaluate(test.windows), test.window_reference),
        build_network_file(network, train, AnchorConfig()),
    )
    for target in lot.targets:
        record = make_record(network, train, _split(target)[0], unit_rmse)
        yield by_size(lot.name, record, network, network_file, lot.unit)


def demo_sizes(path: Path) -> Iterator[list[str]]:
    """Every calibrated unit of a registry, with its own network."""
    with open_registry(f"sqlite:///{path.resolve()}") as registry:
        loader = UnitLoader(registry, ExportOptions(failed_too=True))
        for entry in registry.lots.units():
            if entry.revision is not None:
                unit = loader.load(entry.serial)
                yield by_size("demo", unit.record, unit.network, unit.shared.file, "mN")


def main() -> None:
    """Print the table: medians over targets; or the one by size."""
    parser = parser_of(__doc__, "few units, short training")
    parser.add_argument("--sizes", action="store_true", help="by size of the unit file")
    parser.add_argument("--demo", type=Path, metavar="DB", help="with the units of this registry")
    options = parser.parse_args()
    epochs = 15 if options.quick else 200
    if options.sizes:
        rows = [one for lot in lots(options.quick, 1) for one in lot_sizes(lot, epochs)]
        rows += list(demo_sizes(options.demo)) if options.demo else []
        print_table(("lot", "unit", "span", *(f"{size} B" for size in UNIT_BYTES), "taken"), rows)
        return
    widths = HIDDEN[:: 3 if options.quick else 1]
    head = (
        "lot | network | source, held out | targets, float | targets, device | device - float, % | "
        "device - float, 99 % of rows, worst unit | flagged rows, worst unit, % | ONNX - float, max | "
        "largest unit file, B | units (refused)"
    )
    print_table(head, (row(lot, hidden, epochs) for lot in lots(options.quick) for hidden in widths))


if __name__ == "__main__":
    main()
