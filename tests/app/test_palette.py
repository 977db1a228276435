"""The colours of verdicts: told apart by people of every colour vision, and readable under their text."""

from itertools import combinations

import numpy as np
import pytest

from softcal.app.charts.palette import VERDICT, VERDICT_HATCH, VERDICT_INK, VERDICT_MARK

# Machado, Oliveira and Fernandes (2009), severity 1, on linear RGB.
VISION = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
D65 = np.array([0.95047, 1.0, 1.08883])
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
MIN_DIFFERENCE = 15.0
"""CIE76; about 2.3 is just noticeable side by side."""


def linear(colour: str) -> np.ndarray:
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    xyz = TO_XYZ @ np.clip(rgb, 0, 1) / D65
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISION)
def test_no_two_verdicts_have_one_colour(vision: str) -> None:
    seen_colours = {name: lab(np.asarray(VISION[vision]) @ linear(colour)) for name, colour in VERDICT.items()}
    near = {(a, b): float(np.linalg.norm(seen_colours[a] - seen_colours[b])) for a, b in combinations(seen_colours, 2)}
    assert min(near.values()) > MIN_DIFFERENCE, near


@pytest.mark.parametrize("verdict", VERDICT)
def test_text_on_a_verdict_has_its_contrast(verdict: str) -> None:
    low, high = sorted(float(TO_XYZ[1] @ linear(colour)) for colour in (VERDICT[verdict], VERDICT_INK))
    assert (high + 0.05) / (low + 0.05) >= 4.5


def test_every_verdict_has_a_mark_and_a_hatch_of_its_own() -> None:
    assert VERDICT.keys() == VERDICT_MARK.keys() == VERDICT_HATCH.keys()
    assert len(set(VERDICT_MARK.values())) == len(set(VERDICT_HATCH.values())) == len(VERDICT)
