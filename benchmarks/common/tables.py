"""Tables as docs show them."""

from collections.abc import Iterable


def print_table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a Markdown table, each row as soon as it is known; numbers with four digits."""
    head = list(head)
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head), flush=True)
    for row in rows:
        print("| " + " | ".join(f"{x:.4g}" if isinstance(x, float) else str(x) for x in row) + " |", flush=True)
    print()
