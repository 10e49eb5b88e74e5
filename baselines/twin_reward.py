"""The environment's reward in torch, for the differentiable twin.

The same terms as in `railenv.envs.reward`. Gradients are those of the formulas as they stand: none
where a term has reached its cap, and none from the penalty, which is a constant.
"""

import torch
from torch import Tensor

from baselines.twin_period import FLOOR_ENDS, Rows
from railenv.envs.reward import RECORDED
from railenv.envs.settings import EnvSettings

TERMS = ("comfort", "effort", "stroke", "divergence")
"""Terms of the reward, in the order of the columns."""


class TwinReward:
    """Costs of one control period.

    Args:
        settings: Weights, references, caps and limits.
        rows: Where the results of a period stand.
    """

    def __init__(self, settings: EnvSettings, rows: Rows) -> None:
        self._settings, self._rows = settings, rows
        self._penalty = settings.penalty()

    def assess(self, result: Tensor, applied: Tensor) -> tuple[Tensor, Tensor]:
        """Cost one period.

        Args:
            result: Results of the period, shape (lanes, results); see `PeriodMatrices`.
            applied: Actions as applied, shape (lanes, actions).

        Returns:
            The terms of `TERMS` and the weighted acceleration [m/s^2], shape (lanes, 5), and which
            lanes have left the gauge or diverged, shape (lanes,).
        """
        s, rows = self._settings, self._rows
        recorded = result[:, rows.recorded].unflatten(1, (-1, len(RECORDED)))
        seen = recorded.detach().abs()
        acceleration, displacement = seen[..., :FLOOR_ENDS], seen[..., FLOOR_ENDS : 2 * FLOOR_ENDS]
        diverged = ~(acceleration <= s.acceleration_limit).flatten(1).all(dim=1)
        gone = diverged | ~(displacement <= s.gauge_limit).flatten(1).all(dim=1)
        filtered = result[:, rows.weighted]
        # The norm, unlike the root of a sum, has a gradient of zero at rest.
        weighted = torch.linalg.vector_norm(filtered, dim=1) / filtered.shape[1] ** 0.5
        strokes = recorded[..., 2 * FLOOR_ENDS :].square().mean(dim=(1, 2))
        # After a divergence the environment counts the worst, whatever the vehicle still does.
        worst = s.comfort_cap * s.comfort_reference
        weighted = torch.where(diverged, torch.full_like(weighted, worst), weighted)
        strokes = torch.where(diverged, torch.full_like(strokes, s.stroke_reference**2), strokes)
        terms = [
            -(weighted / s.comfort_reference).clamp(max=s.comfort_cap),
            -s.effort_weight * applied.square().mean(dim=1),
            -s.stroke_weight * (strokes / s.stroke_reference**2).clamp(max=1.0),
            -self._penalty * gone.to(weighted.dtype),
            weighted,
        ]
        return torch.stack(terms, dim=1), gone
