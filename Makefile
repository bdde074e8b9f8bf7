# Needs python3 >= 3.11, make and git; every target uses the environment in .venv, nothing has to be activated.
PYTHON ?= python3
BIN := .venv/bin
RUN := .venv/.run
DEV := .venv/.dev
WORKERS ?= 2
DEMO_OUT ?= demo-report
# every plant and every school, with the detectors that are quick to set up
DEMO_ARGS ?= --seeds 4 --set calibration_error=0.4 --set false_alarm=0.002 --set lengths=2,30 \
	--faults bias,drift,freeze,dropout,three-faults,published \
	--detectors fusing-ekf,loo-glr,loo-cusum,limits-ewma,dynamic-pca,structural-residuals,adaptive-threshold,chebyshev
BENCH_ARGS ?=

# one thread for linear algebra: the work is shared out by process
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: env demo test test-kernels check lint format notebooks bench wheel clean

env: $(DEV)

# what runs, and what tests and checks need besides
$(RUN): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "python3 >= 3.11 is needed; this is " + sys.version.split()[0] + ": make PYTHON=python3.12 env")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[structural]'
	@touch $@

$(DEV): $(RUN)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

demo: $(RUN)
	$(BIN)/fusion-sfdia compare --out '$(DEMO_OUT)' --force $(DEMO_ARGS)

test: $(DEV)
	$(BIN)/python -m pytest -n $(WORKERS) -m 'slow or not slow'

# the quick numerical tests with the linear algebra of other processors
test-kernels: $(DEV)
	$(BIN)/python tests/helpers/kernels.py -n $(WORKERS)

lint: $(DEV)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

check: lint test

format: $(DEV)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

notebooks: $(DEV)
	$(BIN)/python notebooks/run.py

bench: $(RUN)
	$(BIN)/fusion-sfdia bench $(BENCH_ARGS)

wheel: $(DEV)
	$(BIN)/python -m build

clean:
	rm -rf .venv build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
