"""Every driver there is: those in `station/drivers/`, and those that installed packages declare as entry points.

A shipped driver is a module of that folder with a tuple `DRIVERS`. A package of somebody else declares
`[project.entry-points."softcal.readouts"]` (or `softcal.stages`, `softcal.cells`) with `kind = "module:DRIVER"`.
"""

import importlib
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, version

import softcal.station.drivers
from softcal.core.errors import InputError
from softcal.core.plugins import installed
from softcal.core.words.reason import reason
from softcal.station.devices.config import Role
from softcal.station.devices.driver import AnyDriver, Driver

SECTIONS: dict[Role, str] = {"stage": "stage", "cell": "force", "readout": "readout"}
"""Where the keys of a device stand in the station file."""

GROUPS: dict[Role, str] = {"stage": "softcal.stages", "cell": "softcal.cells", "readout": "softcal.readouts"}


@dataclass(frozen=True)
class Offer:
    """One driver that somebody offers.

    Args:
        role, kind: what it calls itself.
        package, version: the distribution it comes from.
        driver: None where it cannot be loaded.
        fault: why not; "" where it can.
    """

    role: Role
    kind: str
    package: str
    version: str
    driver: AnyDriver | None
    fault: str = ""


def offers() -> list[Offer]:
    """Return every driver, shipped ones first; one that cannot be loaded is in the list with its fault."""
    return [*_shipped(), *(_load(role, point) for role, point in _entry_points())]


def driver_of(role: Role, kind: str) -> AnyDriver:
    """Return the driver of a kind; `InputError`: there is none, two packages offer it, or its package is broken."""
    found = [offer for offer in _shipped() if (offer.role, offer.kind) == (role, kind)]
    found += [_load(at, point) for at, point in _entry_points() if (at, point.name) == (role, kind)]
    if not found:
        known = sorted({offer.kind for offer in _shipped() if offer.role == role} | _kinds_of_packages(role))
        raise InputError(
            reason("station_file.unknown_kind", section=SECTIONS[role], kind=repr(kind), known=", ".join(known))
        )
    if len(found) > 1:
        packages = " and ".join(f"{offer.package} {offer.version}" for offer in found)
        raise InputError(reason("station_file.kind_twice", section=SECTIONS[role], kind=repr(kind), packages=packages))
    if found[0].driver is None:
        raise InputError(
            reason(
                "station_file.broken_package",
                section=SECTIONS[role],
                kind=repr(kind),
                fault=found[0].fault,
                package=found[0].package,
            )
        )
    return found[0].driver


@cache
def _shipped() -> tuple[Offer, ...]:
    folder = softcal.station.drivers
    modules = [importlib.import_module(f"{folder.__name__}.{m.name}") for m in pkgutil.iter_modules(folder.__path__)]
    drivers: list[AnyDriver] = [driver for module in modules for driver in getattr(module, "DRIVERS", ())]
    return tuple(Offer(driver.role, driver.kind, "softcal", _own_version(), driver) for driver in drivers)


def _own_version() -> str:
    try:
        return version("softcal")
    except PackageNotFoundError:  # A checkout that is not installed.
        return "unknown"


def _entry_points() -> Iterator[tuple[Role, EntryPoint]]:
    for role, group in GROUPS.items():
        for point in installed(group):
            yield role, point


def _kinds_of_packages(role: Role) -> set[str]:
    return {point.name for point in installed(GROUPS[role])}


def _load(role: Role, point: EntryPoint) -> Offer:
    package, release = (point.dist.name, point.dist.version) if point.dist else ("unknown", "unknown")
    try:
        driver = point.load()
    except (Exception, SystemExit) as error:  # Whatever a package of somebody else does wrong, the others stay usable.
        return Offer(role, point.name, package, release, None, f"cannot be loaded: {type(error).__name__}: {error}")
    if not isinstance(driver, Driver):
        return Offer(
            role, point.name, package, release, None, f"{point.value} is no softcal.station.devices.driver.Driver"
        )
    if (driver.role, driver.kind) != (role, point.name):
        fault = f"{point.value} calls itself {driver.role} {driver.kind!r}; entry point and driver must agree"
        return Offer(role, point.name, package, release, None, fault)
    return Offer(role, point.name, package, release, driver)
