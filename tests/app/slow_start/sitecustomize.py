"""On the path of a screen that tests start: a start stays good as long as a busy machine makes it wait."""

from softcal.app.line import line

line.START_S = 120.0
