"""`softcal train`: the shared network of a lot."""

import argparse
from pathlib import Path

from softcal.app.cli.options import add_network, add_shared, answer, echo_epoch, network_config, registry_of
from softcal.app.output import echo, print_table

EXAMPLES = """examples:
  softcal train lot-1
  softcal train lot-1 --registry sqlite:///line-3.db --hidden 32,16 --seed 7 --json -
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Train f on the source's labelled recording and store it under its content hash. The same recording and
    configuration find the network trained before.
    """
    parser.add_argument("lot", type=Path, metavar="LOT", help="lot folder")
    add_shared(parser, "registry")
    add_network(parser)
    add_shared(parser, "json", "csv")


def run(options: argparse.Namespace) -> None:
    """Train f or load the stored network, and print its id and errors."""
    from softcal.app.batch.train import provide_network
    from softcal.app.files.lot_folder import open_lot_folder
    from softcal.app.registry.reference import declare_reference

    folder = open_lot_folder(options.lot)
    for remark in (*folder.remarks, *folder.source_remarks()):
        echo(f"note: {remark}")
    lot, source = folder.lot, folder.read_source()
    with registry_of(options, create=True) as registry:
        trained = provide_network(
            lot,
            source,
            registry,
            network_config(options),
            on_epoch=lambda report: echo_epoch(report, lot.reference_unit),
        )
        declare_reference(registry, lot.id, folder.reference, source)
    network = trained.network
    header = ["lot", "source", "network", "layers", "status", f"validation RMSE [{lot.reference_unit}]", "train_s"]
    layers, status = "-".join(map(str, network.sizes)), "trained" if trained.is_new else "found, trained before"
    metrics = [trained.metrics.get(name) for name in ("validation_rmse", "train_s")]
    print_table(header, [[lot.id, lot.source, network.id[:16], layers, status, *metrics]])
    answer(options, "train/1", {"lot": lot.id, "network": network.id, "is_new": trained.is_new, **trained.metrics})
