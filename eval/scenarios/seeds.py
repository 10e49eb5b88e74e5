"""Tracks nobody trains on.

A benchmark's tracks have seeds from `railenv.track.seed_domains.FIRST_TEST_SEED` up, which no
environment takes: hashes of the suite's version, an index and a salt. The public salt is empty, so
that everybody can score for himself. Who organises a round takes a private salt, publishes its
commitment first (SHA-256) and the salt afterwards: tracks that nobody can have trained on, and that
everybody can check.
"""

import hashlib
from dataclasses import dataclass

from railenv.errors import ArgumentError, check_count
from railenv.track.seed_domains import FIRST_TEST_SEED

SHORTEST_SALT = 16
"""Characters of a private salt; a short one could be guessed from its commitment."""

_SPAN = 2**62
_PURPOSE = "railenv benchmark track"


def commitment(salt: str) -> str:
    """Return what is published of a private salt beforehand: its SHA-256; "" for no salt.

    Raises:
        ArgumentError: The salt is short.
    """
    return hashlib.sha256(_checked(salt).encode()).hexdigest() if salt else ""


@dataclass(frozen=True)
class TestTracks:
    """The track seeds of a suite's version.

    Attributes:
        version: The suite's version, e.g. "v0".
        salt: Private salt; empty for the public tracks.

    Raises:
        ArgumentError: The salt is short.
    """

    __test__ = False  # pytest: no test class

    version: str
    salt: str = ""

    def __post_init__(self) -> None:
        _checked(self.salt)

    def seed(self, index: int) -> int:
        """Return the seed of the test track with a number from 0."""
        check_count("index", index, minimum=0)
        text = f"{_PURPOSE}/{self.version}/{self.salt}/{index}"
        number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
        return FIRST_TEST_SEED + number % _SPAN

    def stream(self, key: str) -> int:
        """Return the seed of what else is drawn in a scenario: noise, jitter, losses.

        Args:
            key: What the draw is for, e.g. a scenario's key.
        """
        text = f"{_PURPOSE}/{self.version}/{self.salt}/draws/{key}"
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") % _SPAN


def _checked(salt: str) -> str:
    if salt and len(salt) < SHORTEST_SALT:
        raise ArgumentError(
            f"the private salt has {len(salt)} characters and could be guessed from its "
            f"commitment; give {SHORTEST_SALT} random ones or more"
        )
    return salt
