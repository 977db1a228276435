"""`softcal gap effects`: the effects a diagnosis can name, softcal's own and those of plug-ins."""

import argparse
from typing import TYPE_CHECKING

from softcal.app.cli.options import add_csv, add_json

if TYPE_CHECKING:
    from softcal.core.twin.effects import Effect

_EXAMPLES = """examples:
  softcal gap effects
  softcal gap effects --json effects.json
"""


def add_parser(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add the command to those of `softcal gap`."""
    parser = commands.add_parser(
        "effects",
        help="list the effects a diagnosis can name",
        description="List the catalogue of effects: where each acts, its equation, what it needs to be seen, "
        "what it hides behind and which runs show it. Effects of installed plug-ins stand last.",
        epilog=_EXAMPLES,
    )
    add_json(parser)
    add_csv(parser)
    parser.set_defaults(run=_list)


def _list(options: argparse.Namespace) -> int:
    from softcal.app.output import print_table, write_json
    from softcal.core.twin.catalogue import EFFECTS

    if options.json:
        effects = [_record(effect) for effect in EFFECTS.values()]
        write_json(options.json, {"schema": "softcal.gap.effects/1", "effects": effects})
    if options.json != "-" or options.csv:
        header = ["effect", "stage", "equation", "needs", "hides behind", "shown by"]
        print_table(header, [_row(effect) for effect in EFFECTS.values()])
    return 0


def _row(effect: "Effect") -> list[object]:
    signs = effect.signs
    lists = (signs.needs, signs.hides_behind, signs.shown_by)
    return [effect.id, effect.stage, effect.equation, *(", ".join(names) or None for names in lists)]


def _record(effect: "Effect") -> dict[str, object]:
    from softcal.core.twin.catalogue import OWN_EFFECTS

    parameters = [
        {"name": p.name, "unit": p.unit, "low": p.low, "high": p.high, "usual": p.usual} for p in effect.parameters
    ]
    return {
        "effect": effect.id,
        "stage": effect.stage,
        "equation": effect.equation,
        "source": effect.source,
        "parameters": parameters,
        "needs": list(effect.signs.needs),
        "hides_behind": list(effect.signs.hides_behind),
        "shown_by": list(effect.signs.shown_by),
        "forms": [form.effect.equation for form in effect.forms],
        "is_plugin": effect.id not in OWN_EFFECTS,
    }
