"""The live signal of a run as an ECharts option, drawn again and again without a flicker."""

from typing import Any

import pyarrow

from softcal.app.charts.palette import Palette
from softcal.app.texts.reasons import Translator
from softcal.core.orders import Signal


def live_signal(signal: Signal, colours: Palette, translate: Translator, has_force: bool = False) -> dict[str, Any]:
    """Return the option that draws the output over the time of the run, and the stage position.

    With `has_force` the force stands in place of the stage position, where it is measured.
    """
    output, stage = f"{translate('chart.output')} [{signal.output_unit}]", f"{translate('chart.stage')} [mm]"
    second_axis = signal.stage_mm
    if has_force and signal.force_N:
        stage, second_axis = f"{translate('chart.force')} [N]", signal.force_N
    # Not a data frame: turning one into the same bytes costs ten times as much, at every look.
    table = pyarrow.table({"t_s": signal.t_s, output: signal.output, stage: second_axis})
    return {
        "animation": False,
        "backgroundColor": "transparent",
        "dataset": {"source": table},
        "grid": {"left": 70, "right": 64, "top": 34, "bottom": 44},
        "tooltip": {"trigger": "axis"},
        "xAxis": _axis(
            colours.text,
            colours,
            min="dataMin",
            max="dataMax",
            name=translate("chart.time"),
            nameLocation="middle",
            nameGap=26,
        ),
        # Each in the colour of its line, so that the figure needs no legend.
        "yAxis": [
            _axis(colours.mapped, colours, scale=True, name=output),
            _axis(colours.source, colours, scale=True, name=stage, splitLine={"show": False}),
        ],
        "series": [
            _line("t_s", stage, colours.source, 1.2, yAxisIndex=1, areaStyle={"opacity": 0.1}, z=1),
            _line("t_s", output, colours.mapped, 2.5, yAxisIndex=0, z=2),
        ],
    }


def _axis(ink: str, colours: Palette, **more: Any) -> dict[str, Any]:
    label = {"color": ink, "fontSize": 13, "hideOverlap": True, "showMaxLabel": False, "showMinLabel": False}
    line = {"lineStyle": {"color": colours.grid}}
    return {"type": "value", "axisLabel": label, "axisLine": line, "splitLine": line, "nameTextStyle": label} | more


def _line(x: str, y: str, colour: str, width: float, **more: Any) -> dict[str, Any]:
    style = {"color": colour, "width": width}
    look = {"lineStyle": style, "itemStyle": {"color": colour}, "showSymbol": False, "symbol": "none"}
    return {"type": "line", "name": y, "encode": {"x": x, "y": y}, **look, **more}
