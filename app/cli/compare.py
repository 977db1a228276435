"""`softcal compare`: map families side by side on the units of a lot."""

import argparse

from softcal.app.cli.options import COUNT, add_shared, answer, registry_of
from softcal.app.output import echo, print_table
from softcal.core.errors import InputError

EXAMPLES = """examples:
  softcal compare lot-1
  softcal compare lot-1 --maps auto,exact,joint,monotone --units 20 --csv families.csv
"""


def arguments(parser: argparse.ArgumentParser) -> None:
    """Map units of a lot by several families and print their errors side by side: forecast, and measured where a unit
    has an audit. Units with an audit come first. Nothing is stored.
    """
    add = parser.add_argument
    add("lot", metavar="ID", help="lot of the registry")
    families = "auto,exact,monotone,two_point"
    add("--maps", default=families, metavar="FAMILY,..", help=f"as of `softcal batch --map` (default {families})")
    add("--network", metavar="ID", help="shared network; default: the one in use")
    add("--units", default=12, **COUNT, help="so many at most (default 12)")
    add_shared(parser, "registry", "json", "csv")


def run(options: argparse.Namespace) -> None:
    """Map the units by each family and print a row each."""
    from softcal.app.calibration.comparison import compare_on_lot
    from softcal.core.maps.catalogue import check_family

    families = list(dict.fromkeys(check_family(name.strip()) for name in options.maps.split(",")))
    with registry_of(options) as registry:
        unit, network = registry.lots.get(options.lot).reference_unit, options.network
        if network is None:
            state = registry.networks.released(options.lot)
            if state is None:
                raise InputError(f"lot {options.lot!r} has no network in use; run `softcal batch` first")
            network = state.network.id
        request = {"lot": options.lot, "networks": [network], "families": families, "units": options.units}
        rows = compare_on_lot(registry, request, lambda share, label: echo(f"{share:4.0%} {label}"))
    header = ("map", "units", "refused", "passed", f"forecast [{unit}]", "audited", "before", "after", "after, 95 %")
    names = ("family", "units", "refused", "passed", "predicted", "audited", "before", "after", "after_95")
    print_table(header, [[row[name] for name in names] for row in rows])
    answer(options, "compare/1", {"lot": options.lot, "rows": rows})
