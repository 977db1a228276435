"""Calibrate a whole lot without a screen: f, every unit, verdicts, registry; resumable."""

import time
from dataclasses import replace

from softcal.app.batch.lot_work import BatchConfig, Callbacks, LotWork
from softcal.app.batch.report import BatchReport, unused_audits
from softcal.app.batch.train import provide_network
from softcal.app.batch.unit_work import ReadFile
from softcal.app.calibration.audit import update_lot
from softcal.app.calibration.changes import compare_verdicts, read_verdicts
from softcal.app.calibration.lot_context import (
    StoredInputs,
    declare_family,
    declare_line_spread,
    declare_sources,
    lot_method,
    read_lot_context,
)
from softcal.app.calibration.lot_fit import make_batch_fit
from softcal.app.calibration.redecision import redecide_dependent_lots
from softcal.app.calibration.release import decide_lot
from softcal.app.files.lot_folder import LotFolder
from softcal.app.files.measured_at import local_time_remarks
from softcal.app.files.recording_file import prefix_errors
from softcal.app.files.unused_parts import unused_columns
from softcal.app.registry.golden import store_golden_runs
from softcal.app.registry.known_loads import store_loads
from softcal.app.registry.reference import declare_reference
from softcal.app.registry.same_recordings import same_recordings_of
from softcal.core.messages.reason import Reason
from softcal.core.recording import LabelledRecording
from softcal.core.unit.day_correction import fit_day_correction
from softcal.core.unit.source_model import make_source_model
from softcal.db.registry import Registry


def run_batch(folder: LotFolder, registry: Registry, config: BatchConfig, hook: Callbacks = Callbacks()) -> BatchReport:  # noqa: B008 - frozen
    """Calibrate every unit of a lot folder and register the results as they arrive.

    A unit that cannot be read or mapped gets a verdict with its reason, and the lot goes on. What
    the registry has for the same recording, network and configuration is not computed again.

    Raises:
        InputError: the source cannot be used, or the golden run is of another unit: nothing was
            fitted.
    """
    start_s = time.perf_counter()
    before = read_verdicts(registry, folder.lot.id) if folder.lot.id in registry.lots.ids() else {}
    # Known loads that somebody names outrank those that lie in the folder.
    config = replace(config, anchors=config.anchors or folder.read_anchors())
    source_files = folder.inspect_sources().values()
    sources, actor, lot_id = (
        [one.labelled(folder.lot.reference_unit) for one in source_files],
        config.actor,
        folder.lot.id,
    )
    source, read = sources[0], [ReadFile.from_recording(one, one.remarks) for one in source_files]
    networks = [provide_network(folder.lot, one, registry, config.network, actor, hook.on_epoch) for one in sources]
    declare_family(registry, lot_id, config.family or folder.family, actor)
    method = lot_method(registry, lot_id)
    models = [
        make_source_model(one, training.network, method=method) for one, training in zip(sources, networks, strict=True)
    ]
    lot, run = registry.lots.get(lot_id), folder.read_golden()
    declare_line_spread(registry, lot_id, folder.line, actor)
    declare_sources(registry, lot_id, [model.network.id for model in models[1:]], actor)
    declare_reference(registry, lot_id, folder.reference, source, actor)
    stored = StoredInputs(registry, lot_id, list(folder.unit_paths))
    day_correction = None
    if run is not None and folder.golden_path is not None:
        with prefix_errors(folder.golden_path):
            day_correction = fit_day_correction(models[0], run)
    own_config = config.network if config.score_own else None
    context = read_lot_context(registry, lot, models, own_config, stored.golden_runs, day_correction)
    work = LotWork(folder, registry, context, stored, config, hook)
    work.run()
    # Known loads and the golden run that lay beside the files are kept: whoever calibrates those recordings has them.
    hashes = work.recordings([serial for serial in folder.unit_paths if serial in config.anchors])
    loads = {sha256: (serial, config.anchors[serial]) for serial, sha256 in hashes.items()}
    store_loads(registry, lot_id, loads, "file", actor=actor)
    if isinstance(run, LabelledRecording):
        golden = registry.recordings.add(lot_id, run, "audit", actor=actor)
        unit_recordings = {
            sha256: (serial, golden) for serial, sha256 in work.recordings(list(folder.unit_paths)).items()
        }
        unit_recordings[golden] = run.serial, golden
        store_golden_runs(registry, lot_id, unit_recordings, actor=actor)
    plan = make_batch_fit(registry, lot_id, actor)
    release = decide_lot(registry, lot_id, actor)
    audit = update_lot(registry, lot_id, actor)
    redecide_dependent_lots(registry, lot_id, actor)
    changes = compare_verdicts(registry, lot_id, before)
    units = tuple(work.unit_results(list(folder.unit_paths)).values())
    read += sorted(work.files, key=lambda file: file.path)
    names = {file.path: file.path.relative_to(folder.root).as_posix() for file in read}
    layouts = {names[file.path]: file.layout for file in read}
    file_remarks = [f"{names[file.path]}: {remark}" for file in read for remark in file.remarks]
    remarks: list[Reason | str] = [
        *file_remarks,
        *local_time_remarks({file.path: file.start for file in read}),
        *same_recordings_of(registry, lot_id),
        *([] if units else [Reason("lot.no_units")]),
    ]
    unread = unused_columns(folder.root, folder.unit_paths, folder.names)
    not_used = (*folder.not_used, *unread, *unused_audits(folder.audit_paths, units))
    seconds = time.perf_counter() - start_s
    return BatchReport(
        lot_id,
        networks[0],
        units,
        seconds,
        audit,
        config.release,
        release,
        not_used,
        tuple(remarks),
        layouts,
        changes,
        plan,
    )
