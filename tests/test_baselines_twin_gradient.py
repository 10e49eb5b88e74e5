"""Gradients of the differentiable twin: true, late by the delay, and good for learning."""

from typing import Any

import numpy as np
import pytest

from railenv.actuation import DelaySpec, held_input
from railenv.envs.observation import bound, sensor_names
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.vehicle import lateral17, state_space

torch = pytest.importorskip("torch")

from baselines.twin import DifferentiableTwin  # noqa: E402 (torch may be missing)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def test_gradient_through_the_delayed_loop_is_that_of_differences() -> None:
    twin = DifferentiableTwin(
        3, delay=(0.01, 0.08), delay_per_channel=True, action="bogies", track="german_low"
    )
    # One gain for each of three sensors, front and rear, and one for the last action.
    columns = [0, 2, 10, 16, 17]

    def total(gain: Any) -> Any:
        observation = twin.reset(seed=2)
        rewards = []
        for _ in range(60):
            observation, reward, _ = twin.step(observation[:, columns] @ gain)
            rewards.append(reward)
        return torch.stack(rewards).sum()

    gain = 0.1 * torch.randn(5, 2, dtype=torch.float64, generator=torch.manual_seed(0))
    gain.requires_grad_()
    # central differences with 1e-6: rounding 1e-15/1e-6 of a sum of order 10, curvature below
    assert torch.autograd.gradcheck(total, (gain,), eps=1e-6, atol=1e-6, rtol=1e-5)


def test_an_action_is_felt_from_its_delay_on_and_as_a_pulse_of_one_period() -> None:
    delays, scale, period = (0.0, 0.0137, 0.03, 0.0551), 1000.0, 0.01
    twin = DifferentiableTwin(1, delay=DelaySpec(delays), action_scale=scale)
    periods = 10

    def observations(first: Any) -> Any:
        twin.reset(seed=0)
        seen = [twin.step(first[None])[0][0, :16]]
        rest = torch.zeros(1, 4, dtype=torch.float64)
        seen += [twin.step(rest)[0][0, :16] for _ in range(periods - 1)]
        return torch.stack(seen)

    start = torch.zeros(4, dtype=torch.float64)
    found = torch.autograd.functional.jacobian(observations, start).numpy()

    system = state_space(lateral17("paper_fit", 4, 300.0))
    names = sensor_names("4")
    C, D = system.output_rows(names)
    units = scale / np.array([bound(name)[2] for name in names])
    B = system.actuator_input
    for channel, delay in enumerate(delays):
        for k in range(periods):
            time = (k + 1) * period
            expected = np.zeros(len(names))
            # The step up and, a period later, the step down, each by one exponential of its age.
            for sign, begin in ((1.0, delay), (-1.0, delay + period)):
                # an arrival at the very instant of measurement is not yet seen
                if time - begin > 1e-12:
                    _, effect = held_input(system.A, B, time - begin)
                    expected += sign * units * (C @ effect[:, channel] + D[:, channel])
            if time - delay <= 1e-12:
                assert np.all(found[k, :, channel] == 0.0)
            else:
                assert np.abs(found[k, :, channel]).max() > 1e-3
            # rounding of two exponentials; the largest entries are of order one
            np.testing.assert_allclose(found[k, :, channel], expected, atol=1e-10)


def test_no_gradient_beyond_box_and_force_limit() -> None:
    twin = DifferentiableTwin(1, action_scale=40e3)
    twin.reset(seed=0)
    # Outside the box; beyond 30 kN; free; free.
    action = torch.tensor([[1.2, 0.8, 0.5, -0.5]], dtype=torch.float64, requires_grad=True)
    observation, _, _ = twin.step(action)
    (gradient,) = torch.autograd.grad(observation[0, :16].sum(), action)
    assert (gradient[0, :2] == 0.0).all()
    assert (gradient[0, 2:] != 0.0).all()


def test_at_rest_on_a_flat_track_the_gradient_is_finite() -> None:
    twin = DifferentiableTwin(1, track="flat")
    twin.reset(seed=0)
    action = torch.zeros(1, 4, dtype=torch.float64, requires_grad=True)
    total = torch.stack([twin.step(action)[1].sum() for _ in range(5)]).sum()
    total.backward()
    assert total == 0.0
    assert torch.isfinite(action.grad).all()


def test_detaching_cuts_the_gradient_and_changes_no_number() -> None:
    settings = {"delay": 0.0173, "delay_observed": True, "observation_history": 1}
    actions = torch.from_numpy(np.random.default_rng(1).uniform(-1.1, 1.1, (30, 2, 4)))

    def run(cut: bool) -> tuple[Any, Any]:
        twin = DifferentiableTwin(2, **settings)
        twin.reset(seed=1)
        leaf = actions.clone().requires_grad_()
        for k in range(30):
            if cut and k == 15:
                twin.detach()
            observation, reward, _ = twin.step(leaf[k])
        (observation.sum() + reward.sum()).backward()
        return observation, leaf.grad

    (whole, through), (parts, of_window) = run(cut=False), run(cut=True)
    assert torch.equal(whole, parts)
    assert through[:15].abs().max() > 0.0
    assert torch.equal(of_window[:15], torch.zeros_like(of_window[:15]))
    # the same sums in the same order behind the cut
    torch.testing.assert_close(of_window[15:], through[15:], rtol=1e-12, atol=0.0)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_numbers_and_gradients_on_a_cuda_device_are_those_of_the_processor() -> None:
    settings = {
        "delay": (0.0, 0.2),
        "delay_per_channel": True,
        "delay_observed": True,
        "vehicle_ranges": "narrow",
        "vehicle_pool": 3,
        "observation_history": 2,
    }
    results = []
    for device in ("cpu", "cuda"):
        twin = DifferentiableTwin(5, device=device, **settings)
        observation = twin.reset(seed=0)
        gain = torch.full((observation.shape[1], 4), -1e-2, dtype=torch.float64, device=device)
        gain.requires_grad_()
        total = 0.0
        for _ in range(50):
            observation, reward, _ = twin.step(observation @ gain)
            total = total + reward.sum()
        total.backward()
        assert observation.device.type == device
        results.append((observation.detach().cpu(), gain.grad.cpu()))
    (there, slope), (here, gradient) = results
    # sums in another order
    torch.testing.assert_close(here, there, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(gradient, slope, rtol=1e-7, atol=1e-9)


@pytest.mark.learning
def test_a_linear_policy_learns_comfort_by_the_gradient() -> None:
    settings = {"delay": 0.05, "action": "bogies", "track": "german_low"}
    twin = DifferentiableTwin(32, dtype=torch.float32, **settings)
    gain = torch.zeros(len(twin.observation_names), 2, requires_grad=True)
    optimiser = torch.optim.Adam([gain], lr=1e-2)
    for update in range(20):
        if update % 4 == 0:
            twin.reset(seed=1000 + 32 * update)
        observation = twin.detach()
        power = torch.zeros(32)
        for _ in range(250):
            observation, _, info = twin.step(observation @ gain)
            power = power + info["weighted_acceleration"] ** 2 / 250
        loss = torch.log(1.0 + power / 0.05**2).mean()
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_([gain], 1.0)
        optimiser.step()

    def comfort(matrix: np.ndarray) -> float:
        """Mean comfort reward in the environment itself, on episodes never trained on."""
        env = Lateral17VectorEnv(16, **settings)
        observation, _ = env.reset(seed=0)
        terms = []
        for _ in range(1000):
            observation, _, ended, _, info = env.step(observation @ matrix)
            assert not ended.any()
            terms.append(info["reward_comfort"])
        return float(np.mean(terms[300:]))

    before, after = comfort(np.zeros(gain.shape)), comfort(gain.detach().double().numpy())
    # measured: -2.18 before, -0.74 after
    assert after > 0.5 * before
