"""Eight writers at once: no update is lost, no writer sees an error, and the audit chain holds."""

import threading

from softcal.db.connection import open_registry

WRITERS, UPDATES = 8, 6


def test_eight_writers_lose_nothing(registry_url, make_factory):
    with open_registry(registry_url) as registry:
        make_factory(registry)
    errors: list[Exception] = []
    revisions: list[int] = []

    def write(number: int) -> None:
        try:
            with open_registry(registry_url, create=False) as writer:
                factory = make_factory(writer)
                for k in range(UPDATES):
                    revisions.append(factory.calibrate("A1", number * UPDATES + k))
        except Exception as error:
            errors.append(error)

    writers = [threading.Thread(target=write, args=(k,)) for k in range(WRITERS)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert errors == []
    assert sorted(revisions) == list(range(1, WRITERS * UPDATES + 1)), "every writer saw the one before it"
    with open_registry(registry_url, create=False) as registry:
        assert registry.verify() == []
