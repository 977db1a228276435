"""Calibrate a whole lot without a screen: train or reuse f, fit every unit, verdicts, registry; resumable."""

import time
from dataclasses import replace

from softcal.app.batch.audit import update_lot
from softcal.app.batch.judging import judge_leaning
from softcal.app.batch.known import KeptFacts, lot_facts, state_line, state_sources
from softcal.app.batch.lot_work import BatchConfig, LotWork, Watch
from softcal.app.batch.release import judge_lot
from softcal.app.batch.report import BatchReport
from softcal.app.batch.train import train_or_find
from softcal.app.files.lot_folder import LotFolder
from softcal.app.files.recording_file import naming
from softcal.app.registry.golden import keep_golden_of
from softcal.app.registry.known_loads import keep_loads
from softcal.app.registry.reference import state_reference
from softcal.core.recording import LabelledRecording, OutputRecording
from softcal.core.unit.bridge import Bridge, make_bridge
from softcal.core.unit.source_model import SourceModel, make_source_model
from softcal.db.registry import Registry


def run_batch(folder: LotFolder, registry: Registry, config: BatchConfig, watch: Watch = Watch()) -> BatchReport:  # noqa: B008 - frozen
    """Calibrate every unit of a lot folder and register the results as they come.

    A unit whose file cannot be read or that cannot be mapped gets a verdict with its reason, and the lot goes on.
    Whatever the registry already has for the same recording, network and configuration is not computed again.

    Raises:
        InputError: the source cannot be used; without it there is no lot. Or the golden run is of another unit:
            nothing was fitted.
    """
    start_s = time.perf_counter()
    # Known loads that somebody names outrank those that lie in the folder.
    config = replace(config, anchors=config.anchors or folder.read_anchors())
    source = folder.read_source()
    trained = train_or_find(folder.lot, source, registry, config.network, config.actor, watch.on_epoch)
    models = [make_source_model(source, trained.network, method=config.method)]
    for other in folder.read_more_sources():
        found = train_or_find(folder.lot, other, registry, config.network, config.actor, watch.on_epoch)
        models.append(make_source_model(other, found.network, method=config.method))
    lot, run = registry.lots.get(folder.lot.id), folder.read_golden()
    state_line(registry, lot.id, folder.line, config.actor)
    state_sources(registry, lot.id, [model.network.id for model in models[1:]], config.actor)
    state_reference(registry, lot.id, folder.reference, source, config.actor)
    kept = KeptFacts(registry, lot.id, list(folder.unit_paths))
    own, beside = config.network if config.score_own else None, _bridge(folder, models[0], run)
    facts = lot_facts(registry, lot, models, own, kept.golden_runs, beside)
    watch.on_start(len(folder.unit_paths))
    work = LotWork(folder, registry, facts, kept, config, watch)
    work.run()
    # Keep known loads and the golden run that lay beside the files: whoever calibrates those recordings
    # has them
    lot_id, actor = folder.lot.id, config.actor
    of = work.recordings([serial for serial in folder.unit_paths if serial in config.anchors])
    loads = {sha256: (serial, config.anchors[serial]) for serial, sha256 in of.items()}
    keep_loads(registry, lot_id, loads, "file", actor=actor)
    if isinstance(run, LabelledRecording):
        golden = registry.recordings.add(lot_id, run, "audit", actor=actor)
        pressed = {sha256: (serial, golden) for serial, sha256 in work.recordings(list(folder.unit_paths)).items()}
        keep_golden_of(registry, lot_id, pressed, actor=actor)
    decided = judge_lot(registry, folder.lot.id, config.actor)
    audit = update_lot(registry, folder.lot.id, config.actor)
    judge_leaning(registry, folder.lot.id, config.actor)
    judged = work.told(list(folder.unit_paths))
    ordered = tuple(judged[serial] for serial in folder.unit_paths)
    return BatchReport(folder.lot.id, trained, ordered, time.perf_counter() - start_s, audit, config.release, decided)


Golden = OutputRecording | LabelledRecording | None


def _bridge(folder: LotFolder, model: SourceModel, run: Golden) -> Bridge | None:
    if run is None or folder.golden_path is None:
        return None
    with naming(folder.golden_path):
        return make_bridge(model, run)
