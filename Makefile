# Two commands from a fresh clone: `make benchmark` and `make test`. `make check` is what CI runs.
# Another environment folder: make VENV=dir ...

VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet

# Pinned and installed first, so that no other package decides which build is taken. Another build:
# make TORCH="torch==... --index-url ..." test
TORCH ?= torch==2.13.0

# Tests run side by side, as many as there are cores; JOBS= runs them one after the other.
JOBS ?= -n auto --dist worksteal

.PHONY: benchmark test slow static check calibrate evidence clean

benchmark: $(VENV)/.installed-report
	$(BIN)/railenv benchmark --suite quick --out runs/quick

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(JOBS)

slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest $(JOBS) -m "slow or cluster or learning"

static: $(VENV)/.installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

check: static test slow

calibrate: $(VENV)/.installed-report
	$(BIN)/python -m eval.calibrate

# docs/controllers-table.md takes half an hour, docs/policies-table.md more for every policy that is
# shipped, docs/leaderboard.md and docs/rank-stability.md another half. CI runs all in a small size
# (tests/test_eval_zoo.py, _policy_score_command.py, _leaderboard.py, _rank_stability.py).
evidence: $(VENV)/.installed-dev
	OMP_NUM_THREADS=1 $(BIN)/python -m eval.zoo_table
	OMP_NUM_THREADS=1 $(BIN)/python -m eval.policy_evidence
	$(BIN)/railenv benchmark --suite standard --out runs/standard
	$(BIN)/python -m eval.leaderboard runs/standard
	$(BIN)/python -m eval.rank_stability runs/standard --split 3

clean:
	rm -rf build dist *.egg-info .pytest_cache .ruff_cache .hypothesis .import_linter_cache

# A stamp and not the interpreter is the target: it is there only if the environment is whole.
$(VENV)/.made:
	$(PYTHON) -m venv "$(VENV)" && touch "$@"

$(VENV)/.installed-report: pyproject.toml setup.py | $(VENV)/.made
	@start=$$(date +%s); $(PIP) -e ".[report]" && \
	echo "installed in $$(( $$(date +%s) - start )) s" && touch $@

$(VENV)/.installed-dev: pyproject.toml setup.py | $(VENV)/.made
	@start=$$(date +%s); $(PIP) $(TORCH) && $(PIP) -e ".[all,dev]" && \
	echo "installed in $$(( $$(date +%s) - start )) s" && touch $@ $(VENV)/.installed-report
