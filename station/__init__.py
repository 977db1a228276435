"""The station: drivers, motion and recordings. Importing any module registers the messages of its drivers."""

from softcal.station import messages as messages
