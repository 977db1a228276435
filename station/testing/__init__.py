"""Test kit for drivers, shipped or not, on their simulated devices over a real connection.

    import pytest
    from softcal.station.testing import checks
    from lab_meter import DRIVER

    @pytest.mark.parametrize("check", checks(DRIVER), ids=str)
    def test_driver(check):
        check()

Needs no pytest: a check is called and raises `Nonconformity`, an `AssertionError`, with the expected behaviour.
"""

from collections.abc import Callable
from dataclasses import dataclass

from softcal.station.devices.driver import AnyDriver
from softcal.station.testing.common import COMMON
from softcal.station.testing.reader import READER
from softcal.station.testing.rig import DriverRig, Nonconformity
from softcal.station.testing.stage import STAGE

__all__ = ["Check", "Nonconformity", "DriverRig", "checks"]


@dataclass(frozen=True)
class Check:
    """One check of a driver; call it to run the check on a new rig."""

    driver: AnyDriver
    sentence: str
    examine: Callable[[DriverRig], None]

    def __call__(self) -> None:
        with DriverRig(self.driver) as rig:
            self.examine(rig)

    def __str__(self) -> str:
        return f"{self.driver.role} {self.driver.kind}: {self.sentence}"


def checks(driver: AnyDriver) -> list[Check]:
    """Return everything a driver of this role must pass."""
    of_role = STAGE if driver.role == "stage" else READER
    return [Check(driver, sentence, examine) for sentence, examine in {**COMMON, **of_role}.items()]
