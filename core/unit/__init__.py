"""One unit from its recording to map, interval, forecast and verdict. No reference of the unit is seen by a fit."""
