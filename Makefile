# Needs python3 >= 3.11, make and git; every target uses the environment in .venv, nothing has to be activated.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
WORKERS ?= 2
DEMO_OUT ?= demo-report
# every plant and every school, with the detectors that are quick to set up
DEMO_ARGS ?= --seeds 2 --set calibration_seeds=5 --set false_alarm=0.002 \
	--faults bias,drift,freeze,dropout,three-faults,published \
	--detectors fusing-ekf,loo-chi2,loo-glr,limits,structural-residuals,adaptive-threshold,virtual-sensors,chebyshev
BENCH_ARGS ?=

# one thread for linear algebra: the work is shared out by process
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: env demo test check lint format notebooks bench wheel clean

env: $(STAMP)

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "python3 >= 3.11 is needed; this is " + sys.version.split()[0] + ": make PYTHON=python3.12 env")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

demo: $(STAMP)
	$(BIN)/fusion-sfdia compare --out '$(DEMO_OUT)' --force $(DEMO_ARGS)

test: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) -m 'slow or not slow'

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

check: lint test

format: $(STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

notebooks: $(STAMP)
	$(BIN)/python notebooks/run.py

bench: $(STAMP)
	$(BIN)/fusion-sfdia bench $(BENCH_ARGS)

wheel: $(STAMP)
	$(BIN)/python -m build

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
