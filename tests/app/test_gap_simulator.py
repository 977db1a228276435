"""`softcal gap diagnose --simulator` on two mechanisms that are not ours: SciPy's integrator, and MuJoCo."""

import json
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from softcal.app.cli.main import main
from softcal.core.errors import InputError
from softcal.core.gap.simulator import Experiment, Simulator, candidate, planned, recorded
from softcal.core.gap.simulator_model import diagnose_simulator
from softcal.core.twin.effects import Parameter

EXAMPLES = Path(__file__).parents[2] / "examples" / "simulators"
RATE_Hz = 50.0
T = np.arange(int(6 * RATE_Hz)) / RATE_Hz
PUSHES = {
    "sweep": 3.0 * np.sin(2 * np.pi * (0.25 + 0.3 * T) * T),
    "steps": 3.0 * np.sign(np.sin(2 * np.pi * T / 2.8)),
    "slow": 4.0 * np.sin(2 * np.pi * T / 5.0),
}


@pytest.fixture(autouse=True)
def among_the_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)


FINE_s = 2e-5


@numba.njit
def _swing(push_N: np.ndarray, friction_N: float, play_mm: float) -> np.ndarray:
    out, position, speed = np.zeros(len(push_N)), 0.0, 0.0
    steps = int(round(1.0 / RATE_Hz / FINE_s))
    for n in range(len(push_N) - 1):
        for part in range(steps):
            force = push_N[n] + (push_N[n + 1] - push_N[n]) * part / steps
            force -= 0.65 * np.sign(position) * max(abs(position) - play_mm, 0.0) + 0.008 * speed
            force -= friction_N * 2.0 / np.pi * np.arctan(speed / 3.0)
            speed += FINE_s * force * 1000.0 / 1.3
            position += FINE_s * speed
        out[n + 1] = position
    return out


def swing(push_N: np.ndarray, friction_N: float = 0.0, play_mm: float = 0.0) -> np.ndarray:
    """The rig: a second implementation, stepped 25 times finer, with another law of friction (arctan)."""
    return np.asarray(_swing(push_N, friction_N, play_mm))


def write_run(rig: Path, number: int, columns: dict[str, Any], profile: str = "") -> None:
    run = rig / "runs" / str(number)
    run.mkdir(parents=True)
    table, header = np.column_stack([*columns.values()]), ",".join(columns)
    np.savetxt(run / "recording.csv", table, delimiter=",", header=header, comments="", fmt="%.6f")
    if profile:
        (run / "recording.json").write_text(json.dumps({"serial": "S7", "profile": profile}))


def write_rig(folder: Path, noise: float = 0.004, **hidden: float) -> Path:
    rng = np.random.default_rng(5)
    for number, (name, push_N) in enumerate(PUSHES.items(), start=1):
        place_mm = swing(push_N, **hidden)
        place_mm = place_mm + rng.normal(0.0, noise * np.ptp(place_mm), len(T))
        write_run(folder, number, {"t_s": T, "push_N": push_N, "place_mm": place_mm}, name)
    return folder


def diagnosed(folder: Path, simulator: str, out: Path) -> dict[str, Any]:
    assert main(["gap", "diagnose", str(folder), "--simulator", simulator, "--json", str(out)]) == 0
    report: dict[str, Any] = json.loads(out.read_text())
    return report


MASS = "mass_spring_damper:SIMULATOR"


@pytest.mark.long
def test_the_hidden_effect_of_a_swing_is_named_placed_and_sized(tmp_path: Path) -> None:
    report = diagnosed(write_rig(tmp_path / "rig", friction_N=0.4), MASS, tmp_path / "r.json")
    assert report["verdict"] == "explained" and report["causes"][0]["effect"] == "dry_friction"
    assert report["causes"][0]["probability"] > 0.9 and report["where"][0]["stage"] == "guide"
    # The rig's law of friction is another one than the simulator's.
    assert report["causes"][0]["parameters"]["Fc"]["value"] == pytest.approx(0.4, rel=0.15)
    assert report["shrink"]["held_out"] > 0.85
    assert abs(report["shrink"]["predicted"] - report["shrink"]["held_out"]) < 0.1
    assert {tuple(causes) for causes in report["shrink"]["chosen"]} == {("dry_friction",)}
    assert report["parameters"]["k"] == pytest.approx(0.65, rel=0.02)


@pytest.mark.long
def test_a_swing_without_an_effect_has_no_gap(tmp_path: Path) -> None:
    report = diagnosed(write_rig(tmp_path / "rig"), MASS, tmp_path / "r.json")
    assert report["verdict"] == "no_gap" and report["where"] == []
    assert all(cause["probability"] < 0.5 for cause in report["causes"])


@pytest.mark.long
def test_an_effect_that_no_candidate_describes_is_unknown(tmp_path: Path) -> None:
    """Play in the spring: no candidate has it, and the report says where it stands out."""
    report = diagnosed(write_rig(tmp_path / "rig", play_mm=1.0), MASS, tmp_path / "r.json")
    assert report["verdict"] == "unknown"
    assert report["where"] and report["where"][0]["stage"] == "unknown"
    assert all(cause["probability"] < 0.5 for cause in report["causes"])


@pytest.mark.long
def test_a_mujoco_finger_with_a_dry_joint_is_explained(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="pip install mujoco")
    sys.path.insert(0, str(EXAMPLES))
    try:
        import mujoco_finger
    finally:
        sys.path.remove(str(EXAMPLES))
    finger = mujoco_finger.SIMULATOR
    hidden = {"mass_g": 62.0, "damping": 1.3, "rotor.inertia": 0.0, "weak_motor.fade": 0.0, "tendon.stiffness": 0.0}
    rng = np.random.default_rng(2)
    for number, entry in enumerate(finger.experiments.values(), start=1):
        # The rig is stepped eight times finer than the simulator.
        angle = mujoco_finger.simulate(entry.inputs, hidden | {"dry_joint.torque": 0.7}, steps=40)["angle_rad"]
        angle = angle + rng.normal(0.0, 0.003 * np.ptp(angle), len(angle))
        write_run(tmp_path / "rig", number, entry.inputs | {"angle_rad": angle})
    report = diagnosed(tmp_path / "rig", "mujoco_finger:SIMULATOR", tmp_path / "r.json")
    assert report["verdict"] == "explained" and report["causes"][0]["effect"] == "dry_joint"
    assert report["causes"][0]["parameters"]["torque"]["value"] == pytest.approx(0.7, rel=0.1)
    assert report["shrink"]["held_out"] > 0.85


def line(inputs: Any, p: Any) -> dict[str, np.ndarray]:
    """A spring with two effects that look alike at small loads: F² against a slow drift of the zero."""
    load = inputs["load_N"]
    drift = p["drift.rate"] * inputs["t_s"]
    return {
        "place_mm": p["softness"] * load
        + p["bend.a"] * load**2
        + drift
        + p["twin_bend.a"] * load**2 * (1 + 0.02 * load)
    }


LINE = Simulator(
    name="spring",
    run=line,
    inputs=("load_N",),
    channels=("place_mm",),
    base=(Parameter("softness", "mm/N", 0.01, 10.0, 0.5),),
    candidates=(
        candidate("drift", "frame", Parameter("rate", "mm/s", -1.0, 1.0, 0.01, neutral=0.0)),
        candidate("bend", "spring", Parameter("a", "mm/N²", -1.0, 1.0, 0.01, neutral=0.0)),
        candidate("twin_bend", "clamp", Parameter("a", "mm/N²", -1.0, 1.0, 0.01, neutral=0.0)),
    ),
    experiments={
        "light": Experiment({"t_s": T, "load_N": 2.0 * np.abs(np.sin(T))}, minutes=0.5),
        "heavy": Experiment({"t_s": T, "load_N": 60.0 * np.abs(np.sin(T))}, minutes=2.0),
    },
)


def lines(**hidden: float) -> list[Any]:
    p = {"softness": 0.6, "drift.rate": 0.0, "bend.a": 0.0, "twin_bend.a": 0.0} | hidden
    rng, out = np.random.default_rng(4), []
    for name, speed in (("a", 1.0), ("b", 2.3)):
        inputs = {"t_s": T, "load_N": 2.0 * np.abs(np.sin(speed * T))}
        place_mm = line(inputs, p)["place_mm"]
        out.append(recorded(LINE, name, inputs | {"place_mm": place_mm + rng.normal(0.0, 0.004, len(T))}))
    return out


def test_competing_hypotheses_are_a_pair_and_the_run_that_separates_them_is_proposed() -> None:
    diagnosis = diagnose_simulator(LINE, lines(**{"bend.a": 0.01}))
    assert diagnosis.verdict == "ambiguous"
    assert [sorted(pair) for pair in diagnosis.ambiguous_with] == [["bend", "twin_bend"]]
    assert diagnosis.next_experiment.profile == "heavy" and diagnosis.next_experiment.separation_sigma > 10
    heavy = LINE.experiments["heavy"].inputs
    place_mm = line(heavy, {"softness": 0.6, "drift.rate": 0.0, "bend.a": 0.01, "twin_bend.a": 0.0})["place_mm"]
    more = recorded(
        LINE, "heavy", dict(heavy) | {"place_mm": place_mm + np.random.default_rng(9).normal(0, 0.004, len(T))}
    )
    settled = diagnose_simulator(LINE, [*lines(**{"bend.a": 0.01}), more])
    assert settled.verdict == "explained" and settled.causes[0].effect == "bend"


def test_scaling_a_channel_changes_no_answer() -> None:
    """Metres instead of millimetres: every probability, share and shrink stays."""

    def metres(inputs: Any, p: Any) -> dict[str, np.ndarray]:
        return {"place_mm": 1e-3 * line(inputs, p)["place_mm"]}

    scaled = Simulator("spring in m", metres, LINE.inputs, LINE.channels, LINE.base, LINE.candidates, LINE.experiments)
    runs = lines(**{"drift.rate": 0.02})
    small = [recorded(scaled, r.name, dict(r.columns) | {"place_mm": 1e-3 * r.columns["place_mm"]}) for r in runs]
    one, other = diagnose_simulator(LINE, runs), diagnose_simulator(scaled, small)
    assert one.verdict == other.verdict == "explained" and one.causes[0].effect == other.causes[0].effect == "drift"
    assert one.explained_fraction.held_out == pytest.approx(other.explained_fraction.held_out, abs=1e-4)
    assert [c.probability for c in one.causes] == pytest.approx([c.probability for c in other.causes], abs=1e-3)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("mass_spring_damper", "mass_spring_damper"),
        ("no_such_module:SIMULATOR", "no_such_module"),
        ("mass_spring_damper:RATE_Hz", "RATE_Hz"),
    ],
)
def test_a_simulator_that_is_none_is_refused_in_one_line(
    reference: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["gap", "diagnose", str(tmp_path), "--simulator", reference]) not in (0, 1)
    assert message in capsys.readouterr().err


def test_what_a_simulator_gives_is_checked() -> None:
    with pytest.raises(InputError, match="place_mm"):
        recorded(LINE, "run", {"t_s": T, "load_N": T})
    broken = Simulator(
        "broken", lambda i, p: {"place_mm": i["t_s"] * np.nan}, (), ("place_mm",), LINE.base, LINE.candidates
    )
    with pytest.raises(InputError, match="place_mm"):
        diagnose_simulator(broken, [recorded(broken, "run", {"t_s": T, "place_mm": T})])
    with pytest.raises(InputError):
        Simulator("twice", line, (), ("place_mm",), LINE.base, LINE.candidates * 2)
    assert not planned(LINE, "heavy").columns["place_mm"].any()
