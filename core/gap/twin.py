"""Softcal's twin of a soft sensor as the model of a diagnosis."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from softcal.core.gap.case import Case, DataMistake, MenuEntry, RigScale, Run
from softcal.core.gap.diagnosis import Assessment, Diagnosis, ReportingModel, diagnose_with
from softcal.core.gap.evidence import (
    FaultLocation,
    RankedCause,
    Where,
    fault_locations,
    partial_of,
    regime_locations,
    with_residual_location,
)
from softcal.core.gap.experiments import NextExperiment, propose_experiment
from softcal.core.gap.fault_location import (
    cases_of_maps,
    conditions_of_presses,
    explained_twin,
    likely_stages,
    loose_noise,
)
from softcal.core.gap.fit import Map, fit, leader_of, one_less, strongest_regimes, structure
from softcal.core.gap.hypothesis import BASE, Hypothesis, Probe
from softcal.core.gap.method import METHOD, GapMethod
from softcal.core.gap.mistakes import find_repeats, mistakes, outlier_run, outlier_run_with_causes, suspect_units
from softcal.core.gap.model import Block, Directions, Fit, Fits, Problem, Sizes
from softcal.core.gap.residual import noise_levels, with_driving_noise
from softcal.core.gap.search import Progress, Search
from softcal.core.gap.twin_reach import (
    UNMODELLED_EFFECTS,
    WARM_DIVIDER,
    bases_of,
    dither_of,
    excitation_of,
    explanatory_chain_signals,
    first_noise,
    is_resolved,
    menu,
    offset_rows,
    predict_run,
    rough_start,
    terms_of_twin,
    visible_effects,
)
from softcal.core.messages.reason import Reason, reason, several
from softcal.core.recording import Array, Mask
from softcal.core.twin.catalogue import BUILTIN_EFFECTS, EFFECTS
from softcal.core.twin.effects import Alias, Effect
from softcal.core.twin.electronics import mean_code_V
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.mechanics import elastic_force_at
from softcal.core.twin.parameters import BaseParameters
from softcal.core.twin.simulate import twin_record

QUIETEST = 1e-6
"""Least noise of a force that is believed, N on the common rig."""

ONLY_CHANNEL = {"rigid_block": "stage_mm", "dead_weights": "force_N", "dummy_resistor": "output_V"}
"""The one channel that a special run shows."""

SEATED = ("press", "rest")
"""Kinds of run in which the unit lies under the stage."""


@dataclass(frozen=True)
class TwinModel(ReportingModel):
    """The twin of a soft sensor with the effects of a list.

    Args:
        effects: the list that is searched; one that is left out can only be a rest.
    """

    effects: Mapping[str, Effect]
    method: GapMethod = METHOD

    base = BASE
    # Where the stage stands on a rigid block is none.
    channels = ("output_V", "force_N")
    priors = ()
    offset_names = ("zero of force_N", "unloaded resistance", "height of the surface")
    smooth_order = 1
    is_partly_unknown = True
    hands_on_closest = False
    # Whose common part is the base's own: resistance and surface, not the zero of the force.
    are_relative = np.array([False, True, True])
    are_bending = are_relative

    @property
    def candidates(self) -> tuple[Effect, ...]:
        return tuple(self.effects.values())

    # What it predicts.

    def scale_of(self, case: Case) -> RigScale:
        return RigScale.from_case(case)

    def channels_of(self, run: Run) -> tuple[str, ...]:
        # What drives the twin is not predicted.
        alone = "output_V" if run.kind == "press" and run.stage_mm is None else ONLY_CHANNEL.get(run.kind)
        return (alone,) if alone else tuple(c for c in ("force_N", "output_V") if getattr(run, c) is not None)

    def noise_range(self, problem: Problem, channel: str) -> tuple[float, float]:
        min_noise = 0.1 * problem.case.readout.step_V if channel == "output_V" else QUIETEST * problem.scale.factor("N")
        return min_noise, np.inf

    def times_slower(self, case: Case) -> float:
        return 1.0

    def is_free(self, case: Case) -> Array:
        stage, force, output = (case.has(c) for c in ("stage_mm", "force_N", "output_V"))
        # Without a force only κ·k1 and κ·k3 act; k1 stays and κ takes their common factor.
        return np.array([stage, stage and force, stage, output, output])

    def largest_offsets(self, case: Case) -> Array:
        def span(channel: str) -> float:
            values = (getattr(run, channel) for run in case.runs if run.kind in SEATED)
            return max((float(np.ptp(v)) for v in values if v is not None), default=0.0)

        config = self.method.offset
        return np.array([config.tare * span("force_N"), config.resistance, config.seat * span("stage_mm")])

    def clean(self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, sizes: Sizes) -> Array:
        base_values, values = hypothesis.split(coordinates)
        base, dither_V = BaseParameters(*base_values), dither_of(problem)
        bases = bases_of(base, sizes)
        out = np.empty(len(problem.measured))
        last, channels = -1, {}
        for block in problem.blocks:
            # One pass of the chain gives all channels of a run.
            if block.run != last:
                run, last, run_base = problem.case.runs[block.run], block.run, bases.get(block.run, base)
                channels = predict_run(run, last, run_base, hypothesis.chain, values, hypothesis.episodes_of(last))
            channel = channels[block.channel]
            if block.channel == "output_V" and dither_V is not None:
                channel = mean_code_V(channel, dither_V, problem.case.readout.step_V)
            out[block.rows] = channel
            if block.channel == "force_N" and block.run in sizes:
                out[block.rows] += sizes[block.run][0]
        return out

    def directions(
        self, problem: Problem, hypothesis: Hypothesis, coordinates: Array, clean: Array, sizes: Sizes
    ) -> Directions:
        base = BaseParameters(*hypothesis.split(coordinates)[0])
        bases = bases_of(base, sizes)
        out: Directions = []
        for block in problem.blocks:
            run, run_base = problem.case.runs[block.run], bases.get(block.run, base)
            if run.kind not in SEATED:
                out.append(None)
                continue
            # Where nothing is pressed, or nobody knows how deep, the seat changes nothing.
            stage_mm = run.stage_mm if run.stage_mm is not None and run.kind == "press" else np.full(len(run), -np.inf)
            kinds = (block.channel == "force_N", run.readout.sensor_type == "strain")
            parameters = (run_base.u0_mm, run_base.k1_N_mm, run_base.k3_N_mm3, run_base.kappa_per_N)
            out.append(offset_rows(kinds, stage_mm, clean[block.rows], run.readout.vref_V, parameters))
        return out

    # What it leaves.

    def is_clean(self, result: Fit) -> bool:
        return not structure(result).is_significant

    def is_uneven(self, result: Fit) -> bool:
        return loose_noise(result) is not None

    def followed(self, result: Fit, channel: str) -> list[list[Array]]:
        return [explanatory_chain_signals(result, channel)]

    def halves(self, result: Fit, block: Block) -> tuple[Mask | None]:
        """Return where the sensor is pressed."""
        run = result.problem.case.runs[block.run]
        return (None if run.kind != "press" or run.stage_mm is None else run.stage_mm > result.base.u0_mm,)

    def load_of(self, result: Fit) -> Array:
        load, problem = np.zeros(len(result.predicted)), result.problem
        for block in problem.blocks:
            run = problem.case.runs[block.run]
            if run.stage_mm is not None:
                load[block.rows] = elastic_force_at(run.stage_mm, result.base)
            elif run.force_N is not None:
                load[block.rows] = run.force_N
        return load

    def axes_of(self, result: Fit, run: int) -> tuple[str, Array, Array]:
        one = result.problem.case.runs[run]
        load_N = one.force_N if one.force_N is not None else elastic_force_at(np.asarray(one.stage_mm), result.base)
        name, drive = ("force_N", load_N) if one.stage_mm is None else ("stage_mm", one.stage_mm)
        return name, drive, load_N

    # How causes are sought.

    def mistakes(self, case: Case) -> tuple[DataMistake, ...]:
        return mistakes(case, self.method.mistake)

    def base_of_mistaken_case(self, case: Case) -> Fit:
        """Return the base at its rough start, for recordings that are not to be fitted."""
        problem = Problem(self, case, first_noise(case))
        return fit(problem, Hypothesis(), np.nan_to_num(rough_start(case)), steps=0)

    def base_fit(self, case: Case) -> Fit:
        problem = Problem(self, case, first_noise(case))
        fitted = fit(problem, Hypothesis(), rough_start(case))
        for _ in range(2):
            problem = with_driving_noise(problem.with_noise(noise_levels(fitted)), fitted)
            fitted = fit(problem, Hypothesis(), fitted.coordinates)
        return fitted

    def mistakes_by_base(self, base: Fit) -> tuple[tuple[DataMistake, ...], tuple[DataMistake, ...]]:
        outlier = outlier_run(base)
        return () if outlier is None else (outlier,), (
            *suspect_units(base.problem.case, self.method.mistake),
            *find_repeats(base),
        )

    def mistakes_by_search(self, search: "Search") -> tuple[DataMistake, ...]:
        outlier = outlier_run_with_causes(search)
        return () if outlier is None else (outlier,)

    def visible(self, case: Case) -> tuple[Effect, ...]:
        return visible_effects(case, self.effects)

    def probes(self, base: Fit, effects: Sequence[Effect]) -> tuple[Probe, ...]:
        excitation, sized = excitation_of(base), base.problem.scale.sized
        return tuple(Probe(e, row, e.is_one_sided) for e in effects for row in e.probes(excitation, sized))

    def start_again(self, base: Fit, candidates: Sequence[Effect], fits: Fits, store: Callable[[Fit], None]) -> None:
        """Fit the likeliest from other bases: one fitted through a large gap may be far off."""
        likely = sorted(fits.values(), key=lambda f: f.bic)[: self.method.search.again]
        likely += one_less(fits, leader_of(fits)).values()
        first = rough_start(base.problem.case)
        for _ in range(2):
            for result in likely:
                start = np.append(first, result.coordinates[result.hypothesis.of_base.stop :])
                store(fit(result.problem, result.hypothesis, start, steps=40))
            first = leader_of(fits).coordinates[base.hypothesis.of_base]

    def departures(self, case: Case) -> tuple[Effect, ...]:
        is_warming, warmed_K = case.changes("temperature_C"), self.method.unmodelled.warmed_K
        observable = [e for e in UNMODELLED_EFFECTS if e.stage not in case.unseen_stages]
        observable = [e for e in observable if is_warming or not e.parameters[0].unit.endswith("/K")]
        # A dummy resistor that was read while it warmed tells of the electronics.
        return (*observable, *((WARM_DIVIDER,) if case.changes("temperature_C", "dummy_resistor", warmed_K) else ()))

    # What is reported.

    def menu(self, base: Fit) -> tuple[MenuEntry, ...]:
        return menu(base.problem.case, excitation_of(base))

    def terms(self, base: Fit) -> Iterator[EmpiricalTerm]:
        return terms_of_twin(base)

    def maps(self, case: Case) -> tuple[Map, ...]:
        """Fit each chain relation of the base alone, without any effect, and measure what it leaves."""
        return tuple(Map(name, structure(self.base_fit(one))) for name, one in cases_of_maps(case).items())

    def where(self, search: "Search", assessment: "Assessment", causes: Sequence[RankedCause]) -> Where:
        base, best, verdict = search.base, search.best, assessment.verdict
        search.on_progress("refitting the three maps separately")
        maps = self.maps(base.problem.case)
        regime_list = tuple(
            replace(r, channel=short(r.channel)) for r in strongest_regimes(base, conditions_of_presses)
        )
        if verdict == "no_gap":
            return Where((), regime_list, maps)
        structured = [reason("gap.map", map=m.name) for m in maps if m.structure.is_significant]
        detail = reason("gap.seen.maps", maps=several(structured or [Reason("gap.map.none")], "gap.list"))
        channel, regime = (
            (regime_list[0].channel, regime_list[0].name)
            if regime_list
            else ("output", Reason("gap.regime.everywhere"))
        )
        if verdict == "unknown":
            partial = partial_of(search.fits, assessment.best)
            share, largest = partial.share if partial is not None else 0.0, regime_list[0].share if regime_list else 1.0
            locations = _unknown_locations(search, maps, FaultLocation("", channel, regime, largest, detail), share)
        else:
            explaining = [c for c in causes if c.effect in best.ids]
            of_causes = fault_locations(
                explaining, channel, regime, lambda i: reason("gap.seen.effect", effect=i, seen=detail)
            )
            aliases, locations = _open_aliases(best), []
            for c, location in zip(explaining, of_causes, strict=True):
                alias = aliases.get(c.effect)
                if alias is None:
                    locations.append(location)
                    continue
                # The alias takes its share to its own stage.
                ambiguity = reason("gap.seen.alias", alias=Reason.parse(alias.detail))
                locations.append(replace(location, share=(1.0 - alias.share) * location.share))
                locations.append(
                    replace(location, stage=alias.stage, share=alias.share * location.share, detail=ambiguity)
                )
            if verdict == "explained_in_part":
                residual_share = 1.0 - search.explained_share(best)
                locations = with_residual_location(locations, FaultLocation("unknown", channel, regime, residual_share))
        at = max(locations, key=lambda p: p.share).stage
        return Where((*locations, *regime_locations(at, regime_list, "gap.seen.energy")), regime_list, maps)

    def next_experiment(
        self, search: "Search", assessment: "Assessment", telling: NextExperiment | None
    ) -> NextExperiment:
        group, verdict = assessment.group, assessment.verdict
        # Where something is left besides, causes that look alike are told apart all the same.
        proposed = propose_experiment(self.menu(search.start), group) if len(group) > 1 else None
        if proposed is not None and (not assessment.is_partial or proposed.profile != "none"):
            return proposed
        if assessment.is_partial:
            if telling is not None:
                return telling
            explanation, unseen = Reason("gap.next.what_follows"), Reason("gap.next.what_follows_unseen")
            return NextExperiment("rate_sweep", explanation if search.base.problem.case.has("stage_mm") else unseen)
        if verdict == "no_gap":
            return NextExperiment("long_hold", Reason("gap.next.slow"))
        for effect_id, alias in _open_aliases(search.best).items():
            values = {"alias": Reason.parse(alias.detail), "advice": Reason.parse(alias.advice)}
            return NextExperiment(alias.distinguished_by, reason("gap.next.alias", effect=effect_id, **values))
        return NextExperiment("none", Reason("gap.next.separated"))

    def report(self, diagnosis: "Diagnosis[TwinModel]") -> dict[str, object]:
        catalogue_fit, case, is_invalid = diagnosis.catalogue_fit, diagnosis.case, diagnosis.verdict == "data"
        out: dict[str, object] = {"gap": {short(channel): vars(gap) for channel, gap in diagnosis.gap.items()}}
        if (described := diagnosis.residual) is not None:
            first = described.terms[0].term
            twin = explained_twin(described.fit, [one.term for one in described.terms])
            rig = {"load_N": first.load_N, "depth_mm": first.depth_mm, "twin": twin_record(twin)}
            out["residual"] = described.record() | rig
        return out | {
            "missing_channels": list(case.missing_channels),
            "unseen_stages": list(case.unseen_stages),
            "plugins": [effect_id for effect_id in EFFECTS if effect_id not in BUILTIN_EFFECTS],
            "base": {p.name: getattr(catalogue_fit.base, p.name) for p in BASE},
            "noise": {
                short(channel): {"white": sigma, "fading": correlation.spread, "fading_s": correlation.fading_s}
                for channel, sigma in catalogue_fit.problem.sigma.items()
                if (correlation := catalogue_fit.problem.correlation.get(channel)) is not None
            },
            "offsets": [
                {"run": run + 1} | dict(zip(("force_N", "resistance", "seat_mm"), sizes.tolist(), strict=True))
                for run, sizes in catalogue_fit.problem.offset_sizes(
                    catalogue_fit.hypothesis, catalogue_fit.coordinates
                ).items()
            ],
            "twin": None if is_invalid else twin_record(explained_twin(diagnosis.best)),
            "base_twin": None if is_invalid else twin_record(explained_twin(diagnosis.base)),
            "maps": [
                {"map": m.name, "z": m.structure.z, "structured_sigma": m.structure.rms} for m in diagnosis.where.maps
            ],
        }


TWIN = TwinModel(EFFECTS)
"""The twin with every effect of the catalogue."""


def short(channel: str) -> str:
    """Return a channel without its unit, as reports have it."""
    return channel.split("_")[0]


def _open_aliases(best: Fit) -> dict[str, Alias]:
    """What a named cause may be outside the catalogue, where no run tells; by cause."""
    aliases = {i: EFFECTS[i].signs.alias for i in best.ids}
    return {i: alias for i, alias in aliases.items() if alias is not None and not is_resolved(best.problem.case, alias)}


def _unknown_locations(
    search: "Search", maps: tuple[Map, ...], location: FaultLocation, share: float
) -> list[FaultLocation]:
    """Where a gap lies that nothing in the catalogue explains: the likeliest stage first."""
    loose, detail = loose_noise(search.best), location.detail
    stages: tuple[str, ...] = likely_stages(search.base, maps)
    if search.unmodelled is not None:
        effect = next(one for one in (*UNMODELLED_EFFECTS, WARM_DIVIDER) if one in search.unmodelled.effects)
        stages = tuple(dict.fromkeys((effect.stage, *stages)))
        detail = reason("gap.seen.like", like=Reason(effect.id), seen=detail)
    elif loose is not None and (not stages or search.model.is_clean(search.best)):
        stages = tuple(dict.fromkeys((loose.stage, *stages)))
        detail = reason("gap.seen.noise", noise=loose.detail, seen=detail)
    if not stages:
        stages = tuple(dict.fromkeys(EFFECTS[i].stage for i in search.best.ids)) or ("unknown",)
    code = "gap.seen.left" if search.unmodelled is None else "gap.seen.better"
    # Nothing measures how a gap splits between stages that may each hold it: the likelier is first.
    others = [replace(location, stage=stage, detail=Reason("gap.seen.same_maps")) for stage in stages[1:]]
    return [replace(location, stage=stages[0], detail=reason(code, seen=detail, share=share)), *others]


def diagnose(
    case: Case,
    progress: Progress | None = None,
    on_fits: Callable[[Mapping[tuple[str, ...], Fit]], None] | None = None,
    model: TwinModel = TWIN,
) -> Diagnosis[TwinModel]:
    """Diagnose the gap between the twin of a soft sensor and the recordings of a case.

    Args:
        on_fits: called with every hypothesis that was fitted; not where the verdict is `data`.
    """
    return diagnose_with(model, case, progress, on_fits)
