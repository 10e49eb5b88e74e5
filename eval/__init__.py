"""The benchmark: scenarios, rollouts, measures, records, report and the command line.

This package hides the built-in `eval` in a module that says `import eval`; import from it by name
instead: `from eval.rollout import rollout`.
"""
