"""Linear networks as gains: the same actions, and a named refusal for everything else."""

from itertools import pairwise

import numpy as np
import pytest

from baselines import LinearFeedback, linearise
from baselines.linearise import network_matrix
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")
nn = torch.nn

SENSORS = sensor_names("4")


def bare(*sizes: int) -> list:
    torch.manual_seed(3)
    return [nn.Linear(a, b, bias=False) for a, b in pairwise(sizes)]


def test_a_linear_network_and_its_gain_command_the_same() -> None:
    network = nn.Sequential(
        nn.Flatten(), *bare(16, 7), nn.Sequential(nn.Identity(), *bare(7, 5)), *bare(5, 4)
    ).double()
    feedback = linearise(network, 4, action_scale=450.0)
    assert isinstance(feedback, LinearFeedback)
    assert feedback.action_scale == 450.0
    readings = np.random.default_rng(0).normal(size=(6, 16))
    with torch.no_grad():
        expected = network(torch.from_numpy(readings)).numpy()
    # sums of 16 terms in another order
    np.testing.assert_allclose(feedback.act(readings), expected, rtol=1e-12, atol=1e-14)


def test_single_weights_are_taken_exactly() -> None:
    (layer,) = bare(16, 4)
    np.testing.assert_array_equal(
        network_matrix(layer), layer.weight.detach().numpy().astype(float)
    )


def test_the_sensors_of_the_inputs_can_be_named() -> None:
    feedback = linearise(nn.Sequential(*bare(2, 4)), 4, ("carbody_yaw_rate", "carbody_roll_rate"))
    assert feedback.sensors == ("carbody_yaw_rate", "carbody_roll_rate")


def test_a_bias_of_zero_is_no_bias() -> None:
    layer = nn.Linear(16, 4)
    nn.init.zeros_(layer.bias)
    assert network_matrix(layer).shape == (4, 16)


class Hidden(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.net = nn.Linear(16, 4, bias=False)

    def forward(self, x):
        return self.net(x).tanh()


class Bent(nn.Linear):
    def forward(self, x):
        return super().forward(x).relu()


def hooked() -> object:
    (layer,) = bare(16, 4)
    layer.register_forward_hook(lambda module, inputs, output: output.tanh())
    return layer


def biased() -> object:
    network = nn.Sequential(*bare(16, 3), nn.Linear(3, 4))
    nn.init.constant_(network[1].bias, 0.25)
    return network


def broken() -> object:
    (layer,) = bare(16, 4)
    nn.init.constant_(layer.weight, float("inf"))
    return layer


@pytest.mark.parametrize(
    ("network", "message"),
    [
        (nn.Sequential(*bare(16, 3), nn.ReLU(), nn.Tanh()), "network.1 is a ReLU"),
        (nn.Sequential(*bare(16, 3), nn.Sequential(nn.Tanh())), r"network\.1\.0 is a Tanh"),
        (nn.Sequential(*bare(16, 4), nn.Dropout(0.0)), "Dropout"),
        (nn.Sequential(nn.Flatten(0), *bare(16, 4)), "Flatten"),
        (nn.Sequential(nn.BatchNorm1d(16), *bare(16, 4)), "network.0 is a BatchNorm1d"),
        (Hidden(), "network is a Hidden, which is not known to be linear; give Linear"),
        (Bent(16, 4, bias=False), "network is a Bent"),
        (hooked(), "forward hook"),
        (biased(), r"constant action \(up to 0\.25, first bias in network\.1\).*zero"),
        (broken(), r"network\.weight holds a value that is not finite"),
        (nn.Linear(16, 4, bias=False, dtype=torch.complex64), "complex64"),
        (nn.Identity(), "no Linear layer"),
        (nn.Sequential(*bare(16, 3), *bare(5, 4)), "takes 5 inputs and is given 3"),
        (nn.Sequential(*bare(17, 4)), "17 inputs and there are 16 sensors"),
        (nn.Sequential(*bare(16, 3)), r"gain has shape \(3, 16\)"),
        (np.eye(4), "network is a ndarray; give a torch module"),
    ],
)
def test_what_is_no_linear_map_is_refused_by_its_first_layer(network, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        linearise(network, 4)


def test_a_sensor_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ArgumentError, match="carbody_yaw_rate"):
        linearise(nn.Sequential(*bare(1, 4)), 4, ("carbody_yaw_rat",))
