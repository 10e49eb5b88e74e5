"""What every episode of the nonlinear vehicle draws: as of the linear one, on four channels."""

from railenv.envs.episodes import Episodes
from railenv.envs.full_observation import bound_of, measured_names
from railenv.envs.full_settings import FullSettings
from railenv.track.table import FULL_CHANNELS
from railenv.vehicle.nonlinear import FullParameters, FullVehicle


class FullEpisodes(Episodes):
    """Pools, and the episode that every lane is in.

    Args:
        settings: The environment's.
        num_lanes: Number of lanes.

    Attributes:
        full: The pool of nonlinear vehicles; `vehicles` are lateral ones with the same parameters.
    """

    channels = FULL_CHANNELS

    def __init__(self, settings: FullSettings, num_lanes: int) -> None:
        self._contact = settings.contact()
        super().__init__(settings, num_lanes, ())

    @staticmethod
    def limits_of(name: str) -> tuple[float, str, float]:
        """Return the largest reading of a measured column, its unit, and its usual size."""
        return bound_of(name)

    def _prepared(self) -> tuple[tuple[str, ...], None]:
        """Make the nonlinear vehicles; return measured columns. The start is at rest."""
        s = self.settings
        self.full: tuple[FullVehicle, ...] = tuple(
            FullVehicle(
                FullParameters(lateral=car.parameters),
                car.layout,
                car.speed,
                self._contact,
                actuator_lag=s.actuator_lag,
            )
            for car in self.vehicles
        )
        return measured_names(self.full[0], s.observation), None
