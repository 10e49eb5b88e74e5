"""Certificates: a verdict with the evidence that it can be re-checked from, as one JSON file.

A certificate holds the claim, the system's own numbers, the evidence, and a digest of all that. The
digest tells of a file that was changed; whether the evidence proves the claim is decided by
`railenv.stability.verifier`, which does not use the prover's code.
"""

import hashlib
import json
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from railenv.files import replacing

FORMAT = "railenv stability certificate"
SCHEMA = 1

STABLE, UNSTABLE, UNDECIDED = "STABLE", "UNSTABLE", "UNDECIDED"


@dataclass(frozen=True, eq=False)
class Certificate:
    """What was proved, and the evidence.

    Attributes:
        verdict: "STABLE": every root of the region asked for is excluded, for every delay asked
            for. "UNSTABLE": at some delay asked for, a root lies in it. "UNDECIDED": no proof.
        unstable_roots: Number of roots in the region, multiplicities included: 0 if STABLE; at the
            delay of the evidence if UNSTABLE; None where it is not known or not finite.
        reason: Why it is undecided, or where it is unstable.
        claim: The question in plain values.
        system: The system's numbers in plain values.
        evidence: What the verifier needs; empty if UNDECIDED.
        seconds: Time the proof took [s].
    """

    verdict: str
    unstable_roots: int | None
    reason: str
    claim: dict[str, Any]
    system: dict[str, Any] = field(repr=False)
    evidence: dict[str, Any] = field(repr=False)
    seconds: float

    @property
    def proved(self) -> bool:
        """Whether there is a proof, one way or the other."""
        return self.verdict != UNDECIDED

    def to_plain(self) -> dict[str, Any]:
        """Return the certificate as plain values, digest included."""
        content: dict[str, Any] = {
            "format": FORMAT,
            "schema": SCHEMA,
            "verdict": self.verdict,
            "unstable_roots": self.unstable_roots,
            "reason": self.reason,
            "claim": self.claim,
            "system": self.system,
            "evidence": self.evidence,
            "seconds": self.seconds,
            "made_by": _versions(),
        }
        return {**content, "digest": digest(content)}

    def save(self, path: str | Path) -> None:
        """Write the certificate to a JSON file; an existing file is replaced as a whole.

        Raises:
            OutputError: The file cannot be written.
        """
        with replacing(Path(path)) as stream:
            stream.write(json.dumps(self.to_plain(), allow_nan=False).encode())


def digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 digest of plain content, the entry `digest` left out."""
    rest = {key: value for key, value in content.items() if key != "digest"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _versions() -> dict[str, str]:
    return {name: metadata.version(name) for name in ("railenv", "python-flint", "numpy")}
