"""Acts that change verdicts: the command prints what would change, and asks."""

import sys
from typing import TYPE_CHECKING

from softcal.app.output import echo, print_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from softcal.app.calibration.changes import Changes
    from softcal.app.registry.exported_files import Recall
    from softcal.db.registry import Registry

NOT_CONFIRMED = 2
"""Exit code of an act that changes released units and that nobody confirmed."""

MAX_PRINTED = 20
"""So many changes are printed one by one."""


def print_changes(changes: "Changes") -> None:
    """Print what an act would change, a row a unit."""
    if changes.changed:
        rows = [[one.lot_id, one.serial, one.verdict, one.next_verdict, one.reason] for one in changes.changed]
        print_table(("lot", "serial", "now", "then", "why"), rows[:MAX_PRINTED])
        if len(rows) > MAX_PRINTED:
            print(f"and {len(rows) - MAX_PRINTED} more; --json has all")
    if changes.recalled:
        print_recalls(changes.recalled)
    counts = ", ".join(f"{count} {word}" for word, count in changes.counts.items() if count)
    withdrawn, released = len(changes.withdrawn), len(changes.released)
    print(f"units withdrawn: {withdrawn}, released: {released}; then: {counts or 'no unit has a verdict'}")


RECALL_HEADER = ("lot", "serial", "revision on the device", "files in", "computer", "now", "why")


def print_recalls(recalls: "Sequence[Recall]") -> None:
    """Print files that were given out and no longer hold, a row a unit and place."""
    rows = [[one.lot, one.serial, one.revision, one.place, one.host, one.verdict, one.why] for one in recalls]
    print_table(RECALL_HEADER, rows[:MAX_PRINTED])
    if len(rows) > MAX_PRINTED:
        print(f"and {len(rows) - MAX_PRINTED} more; `softcal registry recall` lists all")


def withdraw_files(registry: "Registry", lot_id: str) -> None:
    """Remove files that an act on a lot made invalid from the folders of this computer, and print them."""
    from softcal.app.calibration.changes import list_affected_lots
    from softcal.app.export.export import withdraw_recalled_files

    if recalls := withdraw_recalled_files(registry, list_affected_lots(registry, lot_id)):
        echo(f"recall {len({(one.lot, one.serial) for one in recalls})} devices: softcal registry recall lists them")


def may_do(registry: "Registry", lot_id: str, act: "Callable[[], object]", has_yes: bool) -> bool:
    """Return whether to perform an act on a lot: it changes no released unit and no file, or a person confirms.

    What it would change is printed first; nothing is done yet.
    """
    from softcal.app.calibration.changes import preview

    changes = preview(registry, lot_id, act)
    if not changes.withdrawn and not changes.released and not changes.recalled:
        return True
    print_changes(changes)
    return is_confirmed(has_yes)


def is_confirmed(has_yes: bool) -> bool:
    """Return whether to continue: `--yes` was given, or a person at a terminal confirmed."""
    if has_yes:
        return True
    if not sys.stdin.isatty():
        echo("nothing was changed: there is no terminal to ask on; --yes does it")
        return False
    print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() in ("y", "yes"):
        return True
    echo("nothing was changed")
    return False
