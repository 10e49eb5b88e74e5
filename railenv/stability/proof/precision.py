"""The working precision of ball arithmetic, set for a block and restored after it."""

from collections.abc import Generator
from contextlib import contextmanager

import flint


@contextmanager
def precision(bits: int) -> Generator[None, None, None]:
    """Run a block with this many bits; python-flint keeps the precision in one global place."""
    before = flint.ctx.prec
    flint.ctx.prec = bits
    try:
        yield
    finally:
        flint.ctx.prec = before
