"""Tables as docs show them."""

from collections.abc import Iterable

from softcal.core.metrics import wilson


def print_table(head: str | Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a Markdown table, each row as soon as it is known; numbers with four digits.

    Args:
        head: names of the columns, or all of them with ` | ` between.
    """
    names = head.split(" | ") if isinstance(head, str) else list(head)
    print("| " + " | ".join(names) + " |")
    print("|" + "---|" * len(names), flush=True)
    for row in rows:
        print("| " + " | ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row) + " |", flush=True)
    print()


def wilson_interval(count: int, of: int) -> str:
    """Return the 95 % interval of a share, after Wilson."""
    low, high = wilson(count, of)
    return f"{100 * low:.0f} to {100 * high:.0f} %"
