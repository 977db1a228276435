import pytest
from lab_meter import DRIVER

from softcal.station.testing import checks


@pytest.mark.parametrize("check", checks(DRIVER), ids=str)
def test_driver(check):
    check()
