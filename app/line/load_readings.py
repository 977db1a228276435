"""Known loads of the unit pressed last: accepted readings, and the error of a rejected one."""

from collections.abc import Sequence

import numpy as np

from softcal.core.errors import InputError
from softcal.core.maps.anchors import check_loads, check_values
from softcal.core.maps.config import AnchorConfig
from softcal.core.maps.interface import Anchors
from softcal.core.messages.reason import Reason, Value, reason
from softcal.core.orders import Order
from softcal.core.quality.known_loads import FROM_START, READ, REQUESTED, KnownLoad, loads_text, ordered_load
from softcal.core.quality.reading_at_rest import ReadingConfig, level_at_rest
from softcal.core.recording import Array, LabelledRecording, OutputRecording
from softcal.core.unit.budget import COVERAGE
from softcal.core.unit.source_model import SourceModel

NOT_PRESSED = "nothing was pressed"
DIGITS = 7
"""As many decimals of a level as the files of recordings keep."""


class LoadReadings:
    """Readings of known loads since a unit's run; the next run or the end of the service discards them."""

    def __init__(self, config: ReadingConfig = ReadingConfig()) -> None:  # noqa: B008 - frozen
        self._config = config
        self.forget()

    def forget(self) -> None:
        """Another unit may be in the hand."""
        self._unit: OutputRecording | None = None
        self._lot_id, self._reference_unit = "", ""
        self._loads: tuple[KnownLoad, ...] = ()
        self._levels: dict[int, float] = {}

    def begin(self, order: Order, unit: OutputRecording, loads: Sequence[KnownLoad], reference_unit: str) -> Reason:
        """Start the readings of a pressed unit; return the request for its loads as the result of its run."""
        self.forget()
        self._unit, self._lot_id, self._reference_unit = unit, order.lot_id, reference_unit
        self._loads = tuple(loads)
        return reason(REQUESTED, step=0, **self._request_values)

    def check(self, order: Order) -> None:
        """Refuse a reading of another unit, step or load than the next."""
        step, value = ordered_load(order.reason)
        unit = self._unit
        is_due = unit is not None and (unit.serial, self._lot_id) == (order.serial, order.lot_id)
        if not is_due or step > len(self._levels) + 1 or not 1 <= step <= len(self._loads):
            raise InputError(reason("load.lost", serial=order.serial))
        if self._loads[step - 1].value != value:
            raise InputError(reason("load.lost", serial=order.serial))

    def take(self, order: Order, output: Array, model: SourceModel | None) -> Reason | tuple[OutputRecording, Anchors]:
        """Accept one reading, (n,) of output.

        Return the result of the run or, with the last load, the unit's recording and all its loads.
        """
        self.check(order)
        step = ordered_load(order.reason)[0]
        recorded, load = self._recorded, self._loads[step - 1]
        self._levels = {number: level for number, level in self._levels.items() if number < step}
        try:
            level = level_at_rest(output, recorded.output, load, list(self._levels.values()), self._config)
        except InputError as error:
            return reason(error.reason.code, **{**error.reason.values, "step": step, **self._request_values})
        self._levels[step] = round(level, DIGITS)
        if len(self._levels) < len(self._loads):
            return reason(READ, step=step, level=level, **self._request_values)
        loads = Anchors(np.array(list(self._levels.values())), np.array([load.value for load in self._loads]))
        if model is not None:
            try:
                check_loads(model.source, loads, "the unit was not calibrated", model.method.map.anchors)
            except InputError as error:
                self._levels = {}
                return reason(FROM_START, step=step, why=str(error), **self._request_values)
        return recorded, loads

    @property
    def _recorded(self) -> OutputRecording:
        if self._unit is None:
            raise InputError(reason("load.lost", serial="–"))
        return self._unit

    @property
    def _request_values(self) -> dict[str, Value]:
        """Return the common part of every answer: the loads at the time of the press."""
        return {"loads": loads_text(self._loads), "of": len(self._loads), "unit": self._reference_unit}


def check_declared_loads(loads: Sequence[KnownLoad], source: LabelledRecording, config: AnchorConfig) -> None:
    """Refuse loads, before any was read, that the calibration could not use.

    Raises:
        InputError: out of the source's range, a repeated load, or too large an uncertainty.
    """
    check_values(source, np.array([load.value for load in loads]), NOT_PRESSED, config)
    max_expanded = COVERAGE * config.load_error * float(np.ptp(source.reference))
    for load in loads:
        if load.expanded is not None and load.expanded > max_expanded:
            unit = source.reference_unit
            raise InputError(
                reason("load.uncertain", value=load.value, expanded=load.expanded, most=max_expanded, unit=unit)
            )
