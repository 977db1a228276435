"""Catalogue of drivers: the modules of `station/drivers/` and the entry points of installed packages.

A shipped driver is a module of that folder with a tuple `DRIVERS`. An external package declares
`[project.entry-points."softcal.readouts"]` (or `softcal.stages`, `softcal.cells`) with `kind = "module:DRIVER"`.
"""

import importlib
import pkgutil
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, version

import softcal.station.drivers
from softcal.core.errors import InputError
from softcal.core.messages.reason import reason
from softcal.core.plugins import find_plugins
from softcal.station.devices.config import DEVICES, Role
from softcal.station.devices.driver import AnyDriver, Driver

SECTIONS: dict[Role, str] = {device.role: section for section, device in DEVICES.items()}
"""Where the keys of a device stand in the station file."""

GROUPS: dict[Role, str] = {"stage": "softcal.stages", "cell": "softcal.cells", "readout": "softcal.readouts"}


@dataclass(frozen=True)
class DriverEntry:
    """One driver with its origin, and the error if it cannot be loaded.

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


def list_drivers() -> list[DriverEntry]:
    """Return every driver, shipped drivers first; a driver that cannot be loaded has its error."""
    return [*_shipped(), *(_load(role, point) for role in GROUPS for point in find_plugins(GROUPS[role]))]


def driver_of(role: Role, kind: str) -> AnyDriver:
    """Return the driver of a kind; raise `InputError` if there is none, if there are two, or if it is broken."""
    points = find_plugins(GROUPS[role])
    matches = [offer for offer in _shipped() if (offer.role, offer.kind) == (role, kind)]
    matches += [_load(role, point) for point in points if point.name == kind]
    request = {"section": SECTIONS[role], "kind": repr(kind)}
    if not matches:
        kinds = {offer.kind for offer in _shipped() if offer.role == role} | {point.name for point in points}
        raise InputError(reason("station_file.unknown_kind", known=", ".join(sorted(kinds)), **request))
    if len(matches) > 1:
        packages = " and ".join(f"{offer.package} {offer.version}" for offer in matches)
        raise InputError(reason("station_file.kind_twice", packages=packages, **request))
    (offer,) = matches
    if offer.driver is None:
        raise InputError(reason("station_file.broken_package", fault=offer.fault, package=offer.package, **request))
    return offer.driver


@cache
def _shipped() -> tuple[DriverEntry, ...]:
    folder = softcal.station.drivers
    modules = [importlib.import_module(f"{folder.__name__}.{m.name}") for m in pkgutil.iter_modules(folder.__path__)]
    drivers: list[AnyDriver] = [driver for module in modules for driver in getattr(module, "DRIVERS", ())]
    try:
        softcal_version = version("softcal")
    except PackageNotFoundError:  # A checkout that is not installed.
        softcal_version = "unknown"
    return tuple(DriverEntry(driver.role, driver.kind, "softcal", softcal_version, driver) for driver in drivers)


def _load(role: Role, point: EntryPoint) -> DriverEntry:
    package, release = (point.dist.name, point.dist.version) if point.dist else ("unknown", "unknown")
    driver, fault = None, ""
    try:
        driver = point.load()
    except (Exception, SystemExit) as error:  # Whatever a package of somebody else does wrong, the others stay usable.
        fault = f"cannot be loaded: {type(error).__name__}: {error}"
    if not fault and not isinstance(driver, Driver):
        fault = f"{point.value} is no softcal.station.devices.driver.Driver"
    elif driver is not None and (driver.role, driver.kind) != (role, point.name):
        fault = f"{point.value} calls itself {driver.role} {driver.kind!r}; entry point and driver must agree"
    return DriverEntry(role, point.name, package, release, None if fault else driver, fault)
