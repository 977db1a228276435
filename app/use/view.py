"""A terminal view of a live stream on standard error: the newest estimate, its interval, the map and the alarm."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from softcal.core.unit.estimate import Estimate

if TYPE_CHECKING:
    from rich.table import Table

    from softcal.app.use.adapt import AdaptReport

WIDTH = 48
"""Characters of the bar over the range of the source's reference."""

Show = Callable[[Estimate, "AdaptReport"], None]


@contextmanager
def terminal_view(title: str, low: float, high: float, unit: str) -> Iterator[Show]:
    """Give a function that shows rows and the state of the map, at most eight times a second.

    Args:
        low, high: range of the bar, in `unit`.
    """
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), refresh_per_second=8, transient=False) as live:
        yield lambda rows, report: live.update(_table(title, rows, report, (low, high), unit))


def bar(value: float, lower: float, upper: float, span: tuple[float, float]) -> str:
    """Return a line with the interval as dashes and the estimate as a block; blank without an estimate."""
    if not value == value:
        return " " * WIDTH
    low, high = span
    places = [min(WIDTH - 1, max(0, int((v - low) / (high - low) * WIDTH))) for v in (lower, value, upper)]
    cells = ["-" if places[0] <= k <= places[2] else " " for k in range(WIDTH)]
    cells[places[1]] = "█"
    return "".join(cells)


def _table(title: str, rows: Estimate, report: "AdaptReport", span: tuple[float, float], unit: str) -> "Table":
    from rich.table import Table

    value, lower, upper = (float(column[-1]) for column in (rows.estimate, rows.lower, rows.upper))
    current = report.current
    table = Table(title=title, show_header=False)
    shown = f"{value:8.3f} {unit}   [{lower:.3f}, {upper:.3f}]" if value == value else "no estimate"
    table.add_row("estimate", shown)
    table.add_row(f"{span[0]:.3g} .. {span[1]:.3g} {unit}", bar(value, lower, upper, span))
    table.add_row("row", f"{report.rows} at {float(rows.t_s[-1]):.2f} s   {rows.flag[-1] or 'trusted'}")
    table.add_row("drift", f"shift {current.shift:+.3f} ± {current.shift_sd:.3f}, log gain {current.log_gain:+.3f}")
    table.add_row("map", f"{current.verdict}  {current.reason}")
    table.add_row("predicted error", f"{current.predicted_rmse:.3g} {unit}")
    table.add_row("alarm", current.alarm or "none")
    return table
