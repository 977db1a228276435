"""Shared fixtures: a seeded generator, the measured data sets, and parts that may be missing outside CI."""

import os
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20201900178)


def missing(reason: str) -> None:
    """Skip on a developer's machine, fail in CI: there nothing may pass by skipping."""
    if os.environ.get("CI"):
        pytest.fail(f"{reason}; in CI a missing part is a failure")
    pytest.skip(reason)


@pytest.fixture
def require():  # type: ignore[no-untyped-def]
    """`require(condition, reason)`: go on only where an optional part (PostgreSQL, a browser, QEMU) is there."""

    def check(condition: object, reason: str) -> None:
        if not condition:
            missing(reason)

    return check


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured recordings: $SOFTCAL_DATA, else ../shared/data beside the checkout."""
    root = Path(__file__).parents[1]
    folder = Path(os.environ.get("SOFTCAL_DATA", root.parent / "shared" / "data"))
    if not folder.is_dir():
        missing(f"no measured data in {folder}; set SOFTCAL_DATA")
    return folder
