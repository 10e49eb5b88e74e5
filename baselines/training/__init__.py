"""How policies are trained: settings, methods, the judge that chooses checkpoints, the run.

Importing this package loads neither torch nor stable-baselines3; its methods do when they are made.
"""
