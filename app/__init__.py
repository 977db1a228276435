"""What people and programs use: commands, screens, interfaces, files, jobs."""

from contextlib import suppress

from softcal.core.messages.reason import load_messages_by


def _load_driver_messages() -> None:
    # Kept messages are read where no device is: without the extra `station` those of other people's drivers stay codes.
    with suppress(ImportError):
        from softcal.station.bench.catalogue import list_drivers  # noqa: PLC0415

        list_drivers()


load_messages_by(_load_driver_messages)
