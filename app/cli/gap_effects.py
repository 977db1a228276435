"""`softcal gap effects`: the effects a diagnosis can name, softcal's own and those of plug-ins."""

import argparse
from typing import TYPE_CHECKING

from softcal.app.cli.options import Action, add_shared, answer
from softcal.app.output import print_table

if TYPE_CHECKING:
    from softcal.core.twin.effects import Effect

_EXAMPLES = """examples:
  softcal gap effects
  softcal gap effects --json effects.json
"""


def add_effects(action: Action) -> None:
    """Add the command to those of `softcal gap`."""
    parser = action("effects", "list the effects a diagnosis can name", _list, epilog=_EXAMPLES)
    add_shared(parser, "json", "csv")


def _list(options: argparse.Namespace) -> None:
    """List the catalogue of effects: where each acts, its equation, what it needs to be seen, what
    it hides behind and which runs show it. Effects of installed plug-ins stand last.
    """
    from softcal.core.twin.catalogue import EFFECTS

    if answer(options, "gap.effects/1", {"effects": [_record(effect) for effect in EFFECTS.values()]}):
        header = ["effect", "stage", "equation", "needs", "hides behind", "shown by"]
        rows = []
        for effect in EFFECTS.values():
            lists = (effect.signs.needs, effect.signs.hides_behind, effect.signs.shown_by)
            signs = [", ".join(names) or None for names in lists]
            rows.append([effect.id, effect.stage, effect.equation, *signs])
        print_table(header, rows)


def _record(effect: "Effect") -> dict[str, object]:
    from softcal.core.twin.catalogue import OWN_EFFECTS

    facts = ("name", "unit", "low", "high", "usual")
    return {
        "effect": effect.id,
        "stage": effect.stage,
        "equation": effect.equation,
        "source": effect.source,
        "parameters": [{name: getattr(p, name) for name in facts} for p in effect.parameters],
        "needs": list(effect.signs.needs),
        "hides_behind": list(effect.signs.hides_behind),
        "shown_by": list(effect.signs.shown_by),
        "forms": [form.effect.equation for form in effect.forms],
        "is_plugin": effect.id not in OWN_EFFECTS,
    }
