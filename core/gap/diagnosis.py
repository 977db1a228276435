"""The diagnosis of a case: where the twin is wrong, why, how sure that is, what to press next."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from softcal.core.errors import InputError
from softcal.core.gap.case import Case
from softcal.core.gap.data_mistake import DataMistake
from softcal.core.gap.empirical import learned, terms_of_twin
from softcal.core.gap.explained import explained_twin, in_catalogue_form, with_constants
from softcal.core.gap.fit import Fit
from softcal.core.gap.floor import is_noise
from softcal.core.gap.gap_diagnosis import (
    DiagnosisVerdict,
    GapDiagnosis,
    GapPlace,
    Judgement,
    Partial,
    RankedCause,
    beside_rest,
    judged,
    partial_of,
    places_of,
    ranked_causes,
    regime_places,
    under_its_floor,
)
from softcal.core.gap.generic_effects import stranger_of
from softcal.core.gap.identifiability import Identifiability, identifiability, reasons
from softcal.core.gap.next_experiment import NextExperiment, menu, propose
from softcal.core.gap.offsets import OFFSET_NAMES, Offsets, offsets
from softcal.core.gap.outlier_run import outlier_run, outlier_run_beside
from softcal.core.gap.place import likely_stages, loose_noise
from softcal.core.gap.plausibility import doubts, mistakes
from softcal.core.gap.problem import BASE
from softcal.core.gap.residual import Map, Regime, is_clean, regimes, three_maps
from softcal.core.gap.screen import is_told, visible_effects
from softcal.core.gap.search import EffectSearch
from softcal.core.gap.start import unfitted
from softcal.core.recording import Array
from softcal.core.twin.catalogue import EFFECTS, OWN_EFFECTS
from softcal.core.twin.effects import Alias, Effect
from softcal.core.twin.empirical_terms import EmpiricalTerm
from softcal.core.twin.mechanics import elastic_force_at
from softcal.core.twin.simulate import Twin, twin_record
from softcal.core.words.reason import Reason, reason, several


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(GapDiagnosis[EmpiricalTerm]):
    """The diagnosis of the soft sensor's twin; `best` has each cause by the equation that fits best.

    Args:
        named: the best hypothesis with every cause by the catalogue's equation, as reported.
        rivals: hypotheses that cannot be told apart, the best first.
        maps: the three chain relations fitted separately.
    """

    named: Fit
    rivals: tuple[Fit, ...]
    maps: tuple[Map, ...] = ()
    regimes: tuple[Regime, ...] = ()

    def elastic_force_N(self, run: int) -> Array:
        """Return the force that the fitted base gives for one run with a stage position."""
        stage_mm = self.case.runs[run].stage_mm
        if stage_mm is None:
            raise ValueError(f"run {run} has no stage position")
        return elastic_force_at(stage_mm, self.best.base)

    @property
    def explained(self) -> Twin:
        """The twin to go on with: the refitted base with the set of causes.

        Raises:
            InputError: the recordings hold a mistake; a twin of them would hold it too.
        """
        if self.verdict == "data":
            repairs = "; ".join(f"{f.evidence}: {f.repair}" for f in self.mistakes)
            raise InputError(f"the recordings hold a mistake, so there is no twin of them: {repairs}")
        return explained_twin(self.best)

    @property
    def empirical(self) -> Twin | None:
        """The twin with empirical terms and the causes they stand beside, no diagnosis; None without."""
        if self.residual is None:
            return None
        return explained_twin(self.residual.fit, [one.term for one in self.residual.terms])

    @property
    def offsets(self) -> list[Offsets]:
        """What every run has of its own and no cause has to explain."""
        found = self.named
        return offsets(found.problem, found.base, found.problem.bare.predict(found.hypothesis, found.coordinates))

    def report(self) -> dict[str, object]:
        """Return the report of the contract, ready for JSON."""
        is_spoilt, report = self.verdict == "data", super().report()
        report["gap"] = {_short(channel): vars(gap) for channel, gap in self.gap.items()}
        if self.residual is not None:
            first = self.residual.terms[0].term
            twin = None if self.empirical is None else twin_record(self.empirical)
            report["residual"] = self.residual.record() | {
                "load_N": first.load_N,
                "depth_mm": first.depth_mm,
                "twin": twin,
            }
        return report | {
            "missing_channels": list(self.case.missing_channels),
            "unseen_stages": list(self.case.unseen_stages),
            "plugins": [effect_id for effect_id in EFFECTS if effect_id not in OWN_EFFECTS],
            "base": {p.name: getattr(self.named.base, p.name) for p in BASE},
            "noise": {
                _short(channel): {"white": sigma, "fading": fades.spread, "fading_s": fades.fading_s}
                for channel, sigma in self.named.problem.sigma.items()
                if (fades := self.named.problem.colour.get(channel)) is not None
            },
            "offsets": [vars(one) | {"run": one.run + 1} for one in self.offsets],
            "twin": None if is_spoilt else twin_record(self.explained),
            "base_twin": None if is_spoilt else twin_record(explained_twin(self.base)),
            "maps": [{"map": m.name, "z": m.structure.z, "structured_sigma": m.structure.rms} for m in self.maps],
        }


def _short(channel: str) -> str:
    return channel.split("_")[0]


def diagnose(
    case: Case,
    progress: Callable[[str], None] | None = None,
    on_fits: Callable[[Mapping[tuple[str, ...], Fit]], None] | None = None,
    effects: Mapping[str, Effect] = EFFECTS,
) -> Diagnosis:
    """Diagnose the gap between the base twin and the recordings of a case.

    Args:
        on_fits: called with every hypothesis that was fitted; not where the verdict is `data`.
        effects: the list that is searched; one that is left out can only be a rest.
    """
    say = progress or (lambda _: None)
    say("looking for mistakes in the recordings")
    if spoilt := mistakes(case):
        return _stopped(unfitted(case), spoilt)
    search = EffectSearch.of(case, say, effects=effects)
    runs_tell = told_by(search)
    for untold in reasons(runs_tell):
        say(str(untold))
    if (odd := outlier_run(search.base)) is not None:
        return _stopped(search.base, (odd,))
    search.run()
    if not search.is_clean(search.best) or loose_noise(search.best) is not None:
        search = under_its_floor(search, lambda problem: EffectSearch.of(case, say, problem, effects), is_noise, say)
    if (odd := outlier_run_beside(search)) is not None:
        return _stopped(search.base, (odd,))
    if search.stranger is None:
        search.hold_open()
    judgement = judged(search, effects, say, with_constants, lambda fitted: loose_noise(fitted) is not None)
    verdict, group = judgement.verdict, judgement.group
    best, told = judgement.best, with_constants(judgement.best)
    if on_fits is not None:
        on_fits(search.fits)
    say("refitting the three maps separately")
    maps = three_maps(case)
    named = tuple(in_catalogue_form(found) for found in group)
    held_out = judgement.quantified.shrink.held_out
    causes = ranked_causes(search, best, effects.values(), named, judgement.chances, held_out)
    found_regimes = tuple(replace(r, channel=_short(r.channel)) for r in regimes(search.base))
    say("describing what is left")
    beside = {"unknown": (search.base, told), "no_gap": ()}
    return Diagnosis.of(
        search.base,
        judgement,
        best=told,
        named=named[0],
        rivals=group,
        causes=causes,
        places=_places(search, causes, maps, found_regimes, judgement),
        maps=maps,
        regimes=found_regimes,
        next_experiment=_next(case, search, group, verdict),
        explained_share=search.explained_share(best),
        mistakes=doubts(case),
        partial=partial_of(search, judgement),
        residual=learned(search.base, beside.get(verdict, (told,)), terms_of_twin),
        told=runs_tell,
    )


def checked(case: Case) -> tuple[tuple[DataMistake, ...], Identifiability | None]:
    """Return the mistakes in the recordings and, where there is none, what the runs tell."""
    if spoilt := mistakes(case):
        return spoilt, None
    search = EffectSearch.of(case)
    return doubts(case), told_by(search)


def told_by(search: EffectSearch) -> Identifiability:
    """Return what the runs of a search tell of the twin, and which experiments tell the rest."""
    case = search.base.problem.case
    return identifiability(search.base, visible_effects(case), menu(case, search.extent), OFFSET_NAMES)


def _stopped(base: Fit, found: tuple[DataMistake, ...]) -> Diagnosis:
    return Diagnosis.stopped(base, EFFECTS.values(), found, named=base, rivals=(base,))


def _places(
    search: EffectSearch,
    causes: tuple[RankedCause, ...],
    maps: tuple[Map, ...],
    found: tuple[Regime, ...],
    judgement: Judgement,
) -> tuple[GapPlace, ...]:
    verdict = judgement.verdict
    if verdict == "no_gap":
        return ()
    dirty = [reason("gap.map", map=m.name) for m in maps if m.structure.is_significant]
    detail = reason("gap.seen.maps", maps=several(dirty or [Reason("gap.map.none")], "gap.list"))
    channel, regime = _loudest(found)
    if verdict == "unknown":
        places = _unknown_places(search, maps, found, detail, partial_of(search, judgement))
    else:
        named = [c for c in causes if c.effect in search.best.ids]
        of_causes = places_of(named, channel, regime, lambda i: reason("gap.seen.effect", effect=i, seen=detail))
        aliases, places = _open_aliases(search.best), []
        for c, place in zip(named, of_causes, strict=True):
            alias = aliases.get(c.effect)
            if alias is None:
                places.append(place)
                continue
            # The alias takes its share to its own stage.
            seen = reason("gap.seen.alias", alias=Reason.of(alias.detail))
            places.append(replace(place, share=(1.0 - alias.share) * place.share))
            places.append(replace(place, stage=alias.stage, share=alias.share * place.share, detail=seen))
        if verdict == "explained_in_part":
            left = 1.0 - search.explained_share(search.best)
            places = beside_rest(places, GapPlace("unknown", channel, regime, left))
    at = max(places, key=lambda p: p.share).stage
    return (*places, *regime_places(at, found, "gap.seen.energy"))


def _loudest(found: tuple[Regime, ...]) -> tuple[str, Reason]:
    return (found[0].channel, found[0].name) if found else ("output", Reason("gap.regime.everywhere"))


def _open_aliases(best: Fit) -> dict[str, Alias]:
    """What a named cause may be outside the catalogue, where no run tells; by cause."""
    aliases = {i: EFFECTS[i].signs.alias for i in best.ids}
    return {i: alias for i, alias in aliases.items() if alias is not None and not is_told(best.problem.case, alias)}


def _unknown_places(
    search: EffectSearch,
    maps: tuple[Map, ...],
    found: tuple[Regime, ...],
    detail: Reason,
    partial: Partial | None,
) -> list[GapPlace]:
    """Where a gap lies that nothing in the catalogue explains: the likeliest stage first."""
    channel, regime = _loudest(found)
    share = partial.share if partial is not None else 0.0
    loose = loose_noise(search.best)
    stages: tuple[str, ...] = likely_stages(search.base, maps)
    if search.stranger is not None:
        stranger = stranger_of(search.stranger)
        stages = tuple(dict.fromkeys((stranger.stage, *stages)))
        detail = reason("gap.seen.like", like=Reason(stranger.id), seen=detail)
    elif loose is not None and (not stages or is_clean(search.best)):
        stages = tuple(dict.fromkeys((loose.stage, *stages)))
        detail = reason("gap.seen.noise", noise=loose.detail, seen=detail)
    if not stages:
        stages = tuple(dict.fromkeys(EFFECTS[i].stage for i in search.best.ids)) or ("unknown",)
    code = "gap.seen.left" if search.stranger is None else "gap.seen.better"
    text = reason(code, seen=detail, share=share)
    # Nothing measures how a gap splits between stages that may each hold it: the likelier is first.
    seen = found[0].share if found else 1.0
    others = [GapPlace(s, channel, regime, seen, Reason("gap.seen.same_maps")) for s in stages[1:]]
    return [GapPlace(stages[0], channel, regime, seen, text), *others]


def _next(case: Case, search: EffectSearch, group: tuple[Fit, ...], verdict: DiagnosisVerdict) -> NextExperiment:
    # Where something is left besides, causes that look alike are told apart all the same.
    proposed = propose(case, group, search.extent)
    if proposed is not None and (verdict not in ("unknown", "explained_in_part") or proposed.profile != "none"):
        return proposed
    if verdict in ("unknown", "explained_in_part"):
        seen, unseen = Reason("gap.next.what_follows"), Reason("gap.next.what_follows_unseen")
        return NextExperiment("rate_sweep", seen if case.has("stage_mm") else unseen)
    if verdict == "no_gap":
        return NextExperiment("long_hold", Reason("gap.next.slow"))
    for effect_id, alias in _open_aliases(search.best).items():
        values = {"alias": Reason.of(alias.detail), "advice": Reason.of(alias.advice)}
        return NextExperiment(alias.told_by, reason("gap.next.alias", effect=effect_id, **values))
    return NextExperiment("none", Reason("gap.next.separated"))
