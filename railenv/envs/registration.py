"""Registers railenv's ids with Gymnasium, by string: nothing is imported until an id is made."""

import gymnasium as gym

LATERAL17 = "railenv/Lateral17-v0"
FULL50 = "railenv/Full50-v0"

_ENTRY_POINTS = {
    LATERAL17: (
        "railenv.envs.rail_env:Lateral17Env",
        "railenv.envs.rail_vector_env:Lateral17VectorEnv",
    ),
    FULL50: (
        "railenv.envs.full_env:Full50Env",
        "railenv.envs.full_env:Full50VectorEnv",
    ),
}


def env_ids() -> list[str]:
    """List the registered ids."""
    return list(_ENTRY_POINTS)


def register_envs() -> None:
    """Register every id that is not registered yet."""
    for env_id, (single, vector) in _ENTRY_POINTS.items():
        if env_id not in gym.registry:
            gym.register(  # pyright: ignore[reportUnknownMemberType]
                id=env_id, entry_point=single, vector_entry_point=vector
            )
