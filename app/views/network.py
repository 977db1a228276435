"""Networks of a lot: what each was trained with and reached, and how they compare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from softcal.core.errors import InputError
from softcal.db.registry import Registry

MAX_LAYERS, WIDEST = 6, 512


@dataclass(frozen=True)
class NetworkRow:
    """One network of a lot.

    Args:
        layers: widths of the hidden layers, "120-70-35".
        validation_rmse: error on held-out parts of the source, in the reference unit.
        is_stale: it was trained on an older source recording than the newest.
        is_in_use: whether the line judges by it: the one released last.
        decided: who decided on its state and why; "" where nobody had to.
    """

    id: str
    added_at: datetime
    layers: str
    members: int
    seed: int
    validation_rmse: float | None
    epochs: int | None
    train_s: float | None
    is_stale: bool
    state: str
    is_in_use: bool
    decided: str


def network_rows(registry: Registry, lot_id: str) -> list[NetworkRow]:
    """Return the networks of a lot, newest first."""
    sources = registry.recordings.of_lot(lot_id, kind="source")
    newest = sources[-1].sha256 if sources else ""
    released = registry.networks.released(lot_id)
    in_use_id = released.network.id if released else ""
    rows = []
    for state in reversed(registry.networks.states(lot_id)):
        entry = state.network
        config = entry.training.get("config")
        settings: Mapping[str, Any] = config if isinstance(config, Mapping) else {}
        metrics: Mapping[str, Any] = entry.metrics
        rows.append(
            NetworkRow(
                id=entry.id,
                added_at=entry.added_at,
                layers="-".join(str(width) for width in settings.get("hidden", ())),
                members=int(settings.get("members", 1)),
                seed=int(settings.get("seed", 0)),
                validation_rmse=metrics.get("validation_rmse"),
                epochs=None if metrics.get("epochs") is None else int(metrics["epochs"]),
                train_s=metrics.get("train_s"),
                is_stale=bool(newest) and entry.training.get("source_recording_sha256") != newest,
                state=state.state,
                is_in_use=entry.id == in_use_id,
                decided=f"{state.actor}: {state.reason}" if state.reason else "",
            )
        )
    return rows


def hidden_widths(text: str) -> list[int]:
    """Return one to six widths of hidden layers from a text, "120-70-35" or "120, 70, 35"."""
    parts = [part for part in text.replace("-", ",").replace(" ", ",").split(",") if part]
    if not 1 <= len(parts) <= MAX_LAYERS or not all(p.isdecimal() and 1 <= int(p) <= WIDEST for p in parts):
        raise InputError(
            f"hidden layers {text[:40]!r}: one to {MAX_LAYERS} whole numbers from 1 to {WIDEST} were expected, "
            "for example 120-70-35"
        )
    return [int(part) for part in parts]


def loss_spec(trace: Mapping[str, Sequence[float]], unit: str, names: Mapping[str, str]) -> dict[str, Any]:
    """Return the training curve as ECharts options, which are drawn in place at each update."""
    series = [
        {
            "type": "line",
            "name": names[name],
            "showSymbol": False,
            "data": list(zip(trace["epoch"], trace[name], strict=True)),
        }
        for name in ("train", "validation")
    ]
    return {
        "animation": False,
        "legend": {"top": 0},
        "grid": {"left": 70, "right": 20, "top": 34, "bottom": 44},
        "xAxis": {"type": "value", "name": names["epoch"], "nameLocation": "middle", "nameGap": 26, "minInterval": 1},
        "yAxis": {"type": "log", "name": f"RMSE [{unit}]", "nameLocation": "middle", "nameGap": 52},
        "series": series,
    }
