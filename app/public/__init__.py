"""softcal in Python: train a shared network, fit a unit's map, estimate, open a registry, simulate, diagnose.

    import softcal
    source = softcal.Recording.read("S1.csv", output="output_V", reference="force_N", sample_rate_Hz=50)
    target = softcal.Recording.read("S2.csv", output="output_V", sample_rate_Hz=50)
    unit = softcal.fit_map(softcal.fit_network(source), target)
    print(unit.verdict, unit.predicted_rmse, unit.estimate(target))

The names below are public; what lies in `softcal.app`, `.core`, `.db` and `.station` may change.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from softcal.app.api.diagnosis import diagnose
    from softcal.app.api.estimators import MapTransformer, NetworkRegressor
    from softcal.app.api.example import simulate_recordings
    from softcal.app.api.fitting import UnitTable, fit_map
    from softcal.app.api.lot_fit import LotMaps, compare_sources, fit_lot
    from softcal.app.api.network import SourceNetwork, fit_network
    from softcal.app.api.recording import Recording
    from softcal.app.api.registry import open_registry
    from softcal.app.api.unit import Unit
    from softcal.core.errors import InputError, SoftcalError, UnitRefused
    from softcal.core.twin.simulate import Twin

    __version__: str

_WHERE = {
    "InputError": "softcal.core.errors:InputError",
    "LotMaps": "softcal.app.api.lot_fit:LotMaps",
    "MapTransformer": "softcal.app.api.estimators:MapTransformer",
    "NetworkRegressor": "softcal.app.api.estimators:NetworkRegressor",
    "Recording": "softcal.app.api.recording:Recording",
    "SourceNetwork": "softcal.app.api.network:SourceNetwork",
    "SoftcalError": "softcal.core.errors:SoftcalError",
    "Twin": "softcal.core.twin.simulate:Twin",
    "Unit": "softcal.app.api.unit:Unit",
    "UnitRefused": "softcal.core.errors:UnitRefused",
    "UnitTable": "softcal.app.api.fitting:UnitTable",
    "compare_sources": "softcal.app.api.lot_fit:compare_sources",
    "diagnose": "softcal.app.api.diagnosis:diagnose",
    "fit_lot": "softcal.app.api.lot_fit:fit_lot",
    "fit_map": "softcal.app.api.fitting:fit_map",
    "fit_network": "softcal.app.api.network:fit_network",
    "open_registry": "softcal.app.api.registry:open_registry",
    "simulate_recordings": "softcal.app.api.example:simulate_recordings",
}

__all__ = [
    "InputError",
    "LotMaps",
    "MapTransformer",
    "NetworkRegressor",
    "Recording",
    "SourceNetwork",
    "SoftcalError",
    "Twin",
    "Unit",
    "UnitRefused",
    "UnitTable",
    "__version__",
    "compare_sources",
    "diagnose",
    "fit_lot",
    "fit_map",
    "fit_network",
    "open_registry",
    "simulate_recordings",
]


def __getattr__(name: str) -> Any:
    # Every process of softcal imports this module: nothing is loaded before it is asked for.
    if name == "__version__":
        from importlib.metadata import version

        return version("softcal")
    if name not in _WHERE:
        raise AttributeError(f"module 'softcal' has no attribute {name!r}")
    module, _, attribute = _WHERE[name].partition(":")
    try:
        value = getattr(import_module(module), attribute)
    except ModuleNotFoundError as error:
        from softcal.app.extras import missing_extra

        if (line := missing_extra(error)) is None:
            raise
        raise ModuleNotFoundError(f"softcal.{name}: {line}", name=error.name) from error
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
