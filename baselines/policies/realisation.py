"""Linear laws of finite history as matrices of a sampled law.

    a_k = sum_h G_h y_(k-h) + sum_(h>0) F_h a_(k-h) + v_k

with readings y in SI units, actions a in units of the action scale, and the action v of a law
underneath. Three realisations of the same law:

- `observer_form`: the transposed (observer) form, Kailath, Linear Systems (1980), section 2.1, for
  many outputs. It remembers partial sums instead of readings: H m states for m actions and a
  history of H periods, whatever the number of sensors. Its matrices hold products of gains.
- `affine_form`: nearly as small, with every matrix affine in the gains, so that interpolating the
  matrices is interpolating the gains.
- `ring_form`: remembers the readings themselves, for laws with a state of their own.

All are given as (A, B, C, D, E): x' = A x + B y + E v and a = C x + D y + v.
"""

from typing import NamedTuple

import numpy as np

from baselines.policies.history import History
from railenv.units import FloatArray


class Realisation(NamedTuple):
    """Matrices of x' = A x + B y + E v, a = C x + D y + v.

    Attributes:
        A: Shape (n, n).
        B: Shape (n, sensors).
        C: Shape (actions, n).
        D: Shape (actions, sensors).
        E: Shape (n, actions).
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    E: FloatArray


def gains_by_age(history: History, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gains of readings and of actions by their age.

    Args:
        history: The features.
        weights: Gains of the features, shape (rows, F).

    Returns:
        G of ages 0, 1, ..., shape (H_y + 1, rows, sensors) [1 per SI unit of the sensor], and F of
        ages 1, 2, ..., shape (H_a, rows, actions) [1]; zero at ages that are no features.
    """
    rows, sensors, actions = len(weights), len(history.sensors), history.num_actions
    G = np.zeros((history.sensor_lags[-1] + 1, rows, sensors))
    F = np.zeros((history.action_lags[-1] if history.action_lags else 0, rows, actions))
    scales, start = np.array(history.scales), 0
    for age in history.sensor_lags:
        G[age] = weights[:, start : start + sensors] / scales
        start += sensors
    for age in history.action_lags:
        F[age - 1] = weights[:, start : start + actions]
        start += actions
    return G, F


def observer_form(history: History, weights: FloatArray) -> Realisation:
    """Return the law of some gains with one state per action and period of its history.

    s_j holds what is already known of the action of j periods ahead:
    a = s_1 + G_0 y + v and s_j' = s_(j+1) + G_j y + F_j a.

    Args:
        history: The features.
        weights: Gains, shape (actions, F).
    """
    G, F, depth = _padded(history, weights)
    m, p = history.num_actions, len(history.sensors)
    A, B, E = np.zeros((depth * m, depth * m)), np.zeros((depth * m, p)), np.zeros((depth * m, m))
    C, D = np.zeros((m, depth * m)), G[0].copy()
    if depth:
        C[:, :m] = np.eye(m)
        A[: (depth - 1) * m, m:] = np.eye((depth - 1) * m)
    for j in range(depth):
        rows = slice(j * m, (j + 1) * m)
        A[rows, :m] += F[j]
        B[rows] = G[j + 1] + F[j] @ G[0]
        E[rows] = F[j]
    return Realisation(A, B, C, D, E)


def affine_form(history: History, weights: FloatArray) -> Realisation:
    """Return the law of some gains with matrices that are affine in them.

    As `observer_form`, but the newest reading and action are kept as they are and enter the partial
    sums one period later: s_j = p_j + G_j y_- + F_j a_-, p_j' = s_(j+1), y_-' = y, a_-' = a.

    Args:
        history: The features.
        weights: Gains, shape (actions, F).
    """
    G, F, depth = _padded(history, weights)
    m, p = history.num_actions, len(history.sensors)
    if depth == 0:
        return observer_form(history, weights)
    sums = (depth - 1) * m
    n = sums + p + m
    A, B, E = np.zeros((n, n)), np.zeros((n, p)), np.zeros((n, m))
    C, D = np.zeros((m, n)), G[0].copy()
    reading, action = slice(sums, sums + p), slice(sums + p, n)
    for j in range(depth):
        rows, target = slice(j * m, (j + 1) * m), C if j == 0 else A[(j - 1) * m : j * m]
        if j < depth - 1:
            target[:, rows] += np.eye(m)
        target[:, reading] = G[j + 1]
        target[:, action] = F[j]
    B[reading] = np.eye(p)
    A[action], B[action], E[action] = C, D, np.eye(m)
    return Realisation(A, B, C, D, E)


def ring_form(
    history: History,
    weights: FloatArray,
    transition: FloatArray,
    entry: FloatArray,
    readout: FloatArray,
) -> Realisation:
    """Return a law with a state h of its own: h' = M h + N x, a = W x + R h' + v.

    Args:
        history: The features x.
        weights: W, shape (actions, F).
        transition: M, shape (hidden, hidden).
        entry: N, shape (hidden, F).
        readout: R, shape (actions, hidden).

    Returns:
        The law over past readings, past actions and h.
    """
    m, p, hidden = history.num_actions, len(history.sensors), len(transition)
    G, F = gains_by_age(history, np.vstack([weights + readout @ entry, entry]))
    past_y, past_a = (len(G) - 1) * p, len(F) * m
    ring, n = past_y + past_a, past_y + past_a + hidden
    both = np.zeros((m + hidden, n))
    both[:, :past_y] = np.moveaxis(G[1:], 0, 1).reshape(m + hidden, past_y)
    both[:, past_y:ring] = np.moveaxis(F, 0, 1).reshape(m + hidden, past_a)
    both[:m, ring:], both[m:, ring:] = readout @ transition, transition
    A, B, E = np.zeros((n, n)), np.zeros((n, p)), np.zeros((n, m))
    C, D = both[:m], G[0, :m].copy()
    if past_y:
        B[:p] = np.eye(p)
        A[p:past_y, : past_y - p] = np.eye(past_y - p)
    if past_a:
        newest = slice(past_y, past_y + m)
        A[newest], B[newest], E[newest] = C, D, np.eye(m)
        A[past_y + m : ring, past_y : ring - m] = np.eye(past_a - m)
    A[ring:], B[ring:] = both[m:], G[0, m:]
    return Realisation(A, B, C.copy(), D, E)


def _padded(history: History, weights: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return G of ages 0 to H and F of ages 1 to H, and H."""
    G, F = gains_by_age(history, weights)
    depth = max(len(G) - 1, len(F))
    m = history.num_actions
    G = np.concatenate([G, np.zeros((depth + 1 - len(G), *G.shape[1:]))])
    F = np.concatenate([F, np.zeros((depth - len(F), m, m))])
    return G, F, depth
