"""Proofs in exact rational and ball arithmetic (python-flint): what carries a certificate.

Floating point only proposes here (where to split, where a root might be); whatever a verdict rests
on is an exact rational number or a ball that encloses the truth. Every double of the given system
is taken as the exact number it is.
"""
