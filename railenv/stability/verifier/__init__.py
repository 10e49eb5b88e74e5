"""The verifier: re-checks a certificate without the code that made it.

It uses python-flint and the standard library, and nothing else of this library but the kinds of its
errors. What it trusts in a certificate are only the numbers of the system and of the claim; pieces,
cuts and matrices of the evidence are suggestions that it checks.
"""

from railenv.stability.verifier.file import Verification, verify_certificate

__all__ = ["Verification", "verify_certificate"]
