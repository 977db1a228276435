"""The station: drivers, motion, recordings. Whatever of it is imported, the messages of its drivers are known."""

from softcal.station import messages as messages
