"""Training of the shared network: it learns, repeats itself, merges exactly and refuses what cannot teach it."""

import numpy as np
import pytest
import torch

from softcal.core.errors import InputError
from softcal.core.network.config import NetworkConfig
from softcal.core.network.network import Network
from softcal.core.network.training import fit_network, merge_members, validation_blocks
from softcal.core.recording import LabelledRecording, OutputRecording

QUICK = NetworkConfig(hidden=(16, 8), max_epochs=12)


def recording(output: np.ndarray, reference: np.ndarray) -> LabelledRecording:
    return LabelledRecording(OutputRecording("S", np.arange(len(output)) / 50.0, output, 50.0), reference)


@pytest.fixture
def smooth(rng: np.random.Generator) -> LabelledRecording:
    force_N = 1.5 + 1.4 * np.sin(np.cumsum(rng.uniform(0.02, 0.2, 1500)))
    return recording(0.5 + 0.1 * force_N + 0.02 * force_N**2, force_N)


def test_network_learns_a_static_curve_to_a_few_percent(smooth: LabelledRecording) -> None:
    trained = fit_network(smooth)
    error = trained.network.evaluate(smooth.windows) - smooth.window_reference
    assert np.sqrt(np.mean(error**2)) < 0.05 * np.ptp(smooth.reference)
    assert trained.network.sizes == (15, 120, 70, 35, 1)


def test_an_exact_estimate_does_not_depend_on_what_is_estimated_beside_it(smooth: LabelledRecording) -> None:
    network = fit_network(smooth, QUICK).network
    together = network.evaluate_exactly(smooth.windows)
    alone = np.concatenate([network.evaluate_exactly(smooth.windows[k : k + 1]) for k in range(50)])
    np.testing.assert_allclose(alone, together[:50], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(network.evaluate(smooth.windows), together, atol=1e-5 * np.ptp(together))


def test_equal_seeds_give_the_same_network_and_other_seeds_another(smooth: LabelledRecording) -> None:
    first, again = fit_network(smooth, QUICK), fit_network(smooth, QUICK)
    other = fit_network(smooth, NetworkConfig(hidden=(16, 8), max_epochs=12, seed=1))
    assert first.network.id == again.network.id != other.network.id


def test_training_leaves_torch_as_it_was(smooth: LabelledRecording) -> None:
    threads, state = torch.get_num_threads(), torch.get_rng_state()
    fit_network(smooth, QUICK)
    assert torch.get_num_threads() == threads
    assert torch.equal(torch.get_rng_state(), state)


def test_every_epoch_is_reported(smooth: LabelledRecording) -> None:
    reports = []
    trained = fit_network(smooth, QUICK, reports.append)
    assert [r.epoch for r in reports] == list(range(1, trained.epochs[0] + 1))
    assert min(r.validation_rmse for r in reports) == pytest.approx(reports[-1].best_validation_rmse)
    assert trained.validation_rmse == pytest.approx(reports[-1].best_validation_rmse, rel=1e-3)


def test_ensemble_is_one_network_that_gives_the_mean(smooth: LabelledRecording) -> None:
    members = [fit_network(smooth, NetworkConfig(hidden=(16, 8), max_epochs=4, seed=s)).network for s in (0, 1, 2)]
    merged = fit_network(smooth, NetworkConfig(hidden=(16, 8), max_epochs=4, members=3)).network
    mean = np.mean([n.evaluate(smooth.windows) for n in members], axis=0)
    assert np.allclose(merged.evaluate(smooth.windows), mean, atol=1e-4)


def test_merging_one_member_changes_nothing(rng: np.random.Generator) -> None:
    layers = [(rng.normal(size=(15, 4)), rng.normal(size=4)), (rng.normal(size=(4, 1)), rng.normal(size=1))]
    weights, biases = merge_members([layers])
    assert all(np.array_equal(w, pair[0]) for w, pair in zip(weights, layers, strict=True))
    assert all(np.array_equal(b, pair[1]) for b, pair in zip(biases, layers, strict=True))


def test_gradient_agrees_with_torch(rng: np.random.Generator) -> None:
    weights = (rng.normal(size=(15, 9)), rng.normal(size=(9, 5)), rng.normal(size=(5, 1)))
    biases = (rng.normal(size=9), rng.normal(size=5), rng.normal(size=1))
    network, inputs = Network(weights, biases, 0.3, 0.2, 1.0, 2.0), rng.normal(size=(20, 15))
    x = torch.tensor(inputs, requires_grad=True)
    hidden = (x - 0.3) / 0.2
    for weight, bias in zip(weights[:-1], biases[:-1], strict=True):
        hidden = torch.relu(hidden @ torch.tensor(weight) + torch.tensor(bias))
    estimate = 1.0 + 2.0 * (hidden @ torch.tensor(weights[-1]) + torch.tensor(biases[-1]))[:, 0]
    estimate.sum().backward()
    value, slope = network.gradient(inputs)
    # Computed in float32: 1e-5 of the largest.
    assert np.allclose(value, estimate.detach().numpy(), rtol=1e-5, atol=1e-5 * float(estimate.detach().abs().max()))
    assert x.grad is not None
    assert np.allclose(slope, x.grad.numpy(), rtol=1e-5, atol=1e-5 * float(x.grad.abs().max()))


@pytest.mark.parametrize("count", [150, 800, 20_000])
def test_validation_is_several_blocks_of_the_asked_share(count: int) -> None:
    mask = validation_blocks(count, 0.15)
    blocks = int(np.sum(np.diff(mask.astype(int)) == 1))
    assert 2 <= blocks <= 10
    assert mask.mean() == pytest.approx(0.15, abs=0.03)


def constant_output(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, 0.5), np.linspace(0, 3, n)


def constant_reference(n: int) -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(0.5, 1, n), np.zeros(n)


def saturated(n: int) -> tuple[np.ndarray, np.ndarray]:
    force_N = 1.5 + 1.5 * np.sin(np.arange(n) / 20)
    return np.minimum(force_N, 1.2), force_N


@pytest.mark.parametrize(
    ("make", "count", "message"),
    [
        (constant_output, 600, "output"),
        (constant_reference, 600, "reference"),
        (saturated, 900, "%"),
        (saturated, 100, "150"),
    ],
)
def test_source_that_cannot_teach_is_refused_in_one_line(make, count: int, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=rf"\bS\b.*{message}") as refused:
        fit_network(recording(*make(count)))
    assert "\n" not in str(refused.value)


def test_reference_that_has_nothing_to_do_with_the_output_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(InputError):
        fit_network(recording(rng.normal(size=1200), rng.normal(size=1200)), QUICK)
