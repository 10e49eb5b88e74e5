"""Gymnasium environments; importing this package registers their ids and nothing else."""
