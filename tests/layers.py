"""The values of a parameter in two layers: a few in every run, the others in the long one."""

from collections.abc import Collection, Iterable
from typing import Any

import pytest


def layered(values: Iterable[Any], quick: Collection[Any]) -> list[Any]:
    """Return the values as `parametrize` takes them; those that are not among the quick ones are marked `long`."""
    return [value if value in quick else pytest.param(value, marks=pytest.mark.long) for value in values]
