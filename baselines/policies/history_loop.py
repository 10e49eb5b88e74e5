"""A linear policy around a vehicle as a loop of finite history, for proofs over ranges of delays.

The policy's actions are the loop's signals: with features x = (y / scales, past actions) the law
a = W x is v_k = -sum_h G_h y_(k-h) - sum_h F_h v_(k-h), G and F the gains with their sign turned. A
static classical law underneath adds to G_0; one with states of its own is no finite history.
"""

import math

import numpy as np

from baselines.controller import LinearFeedback, check_layout, plant_seen
from baselines.policies.base_law import BaseLaw, spread_of
from baselines.policies.linear import LinearPolicy
from baselines.policies.realisation import gains_by_age
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, check_positive
from railenv.stability import FiniteHistoryLoop
from railenv.vehicle import LateralVehicle


def has_history_loop(controller: object) -> bool:
    """Whether a controller is a linear policy of finite history, its base included."""
    return isinstance(controller, LinearPolicy) and (
        controller.base is None or isinstance(controller.base, LinearFeedback)
    )


def to_history_loop(
    policy: object,
    vehicle: LateralVehicle,
    period: float,
    actuator: ActuatorSpec | None = None,
) -> FiniteHistoryLoop:
    """Close the loop around a vehicle.

    Exact for motion inside the box of actions, up to rounding of the gains to double precision.

    Args:
        policy: The policy.
        vehicle: The vehicle; its layout must be the policy's.
        period: Control period [s]; it must be the policy's own.
        actuator: Its lag becomes part of the plant; limits do not act on small motion.

    Raises:
        ArgumentError: The policy is no linear one, its base has states of its own, or layouts or
            periods differ.
    """
    if not isinstance(policy, LinearPolicy) or not has_history_loop(policy):
        raise ArgumentError(
            f"policy {type(policy).__name__} is no linear law of finite history; give a "
            "LinearPolicy without a base or on a static one, or ask law_at(told) for one told delay"
        )
    check_layout(policy.layout, vehicle)
    if not math.isclose(
        check_positive("period", period, "seconds"), policy.control_period, rel_tol=1e-9
    ):
        raise ArgumentError(
            f"period = {period:g} s, but the policy acts every control_period = "
            f"{policy.control_period:g} s; use the same for both"
        )
    history = policy.history
    gains = [gains_by_age(history, weights) for weights in policy.weights]
    # Readings that only the base takes stand behind those of the history.
    own = np.stack([G for G, _ in gains])
    measured = np.zeros((*own.shape[:3], len(policy.sensors)))
    measured[..., : len(history.sensors)] = own
    if policy.base is not None:
        base = BaseLaw(policy.base, history)
        direct = base.matrices()[3]
        for column, name in enumerate(base.sensors):
            measured[:, 0, :, policy.sensors.index(name)] += direct[:, column]
    plant = plant_seen(vehicle, policy.sensors, actuator)
    return FiniteHistoryLoop(
        A=plant.A,
        B=plant.B,
        C=plant.C,
        D=plant.D,
        period=policy.control_period,
        measured=-measured,
        commanded=-np.stack([F for _, F in gains]),
        spread=policy.action_scale * spread_of(history),
        told=np.array(history.told_knots or (0.0,)),
    )
